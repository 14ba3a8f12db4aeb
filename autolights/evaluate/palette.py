"""Colours of the report, in one place: those of states, of marks in pictures, and of figures."""

from autolights.core import SignalSet

LAMP = {"red": "#e5484d", "yellow": "#f5b400", "green": "#2fa866"}
DARK = "#5f6b7a"  # a light with nothing lit
MAP = "#22d3ee"  # boxes from the map: cyan, as in the paper's figure
ASSOCIATION = "#4ade80"
MISSED = "#ffffff"
FLASHING = "#fb923c"
OCCLUSION = "#8b949e"
ACCENT = "#3b6fe0"
SERIES = ("#3b6fe0", "#e0683b", "#7c5cd6", "#2fa866")

# Figures are drawn in these; in the page they become variables of its style sheet, so that they follow dark mode.
INK, MUTED, GRID, PAPER = "#1a1f26", "#69707a", "#dfe3e8", "#fffffe"
STYLE_VARIABLES = {INK: "var(--ink)", MUTED: "var(--muted)", GRID: "var(--line)", PAPER: "var(--card)"}


def state_colors(class_name: str, signals: SignalSet) -> tuple[str, ...]:
    """Colours of a state's lit lamps from top to bottom, `DARK` alone if none is lit."""
    lamps = signals.types[signals.type_of[class_name]].lamps
    lit = sorted((lamps[name] for name in signals.state(class_name).lit), key=lambda lamp: lamp.center[1])
    return tuple(LAMP[lamp.color] for lamp in lit) or (DARK,)


def main_color(class_name: str, signals: SignalSet) -> str:
    """One colour for a state: of two lit lamps the lower one, which tells it from the plain state."""
    return state_colors(class_name, signals)[-1]


def bgr(color: str) -> tuple[int, int, int]:
    """``#rrggbb`` as OpenCV wants it."""
    red, green, blue = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return blue, green, red
