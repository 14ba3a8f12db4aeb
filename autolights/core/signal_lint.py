"""What is legal in a signal description, but hardly meant."""

from collections.abc import Iterator

from autolights.core.signals import Lamp, LightType, SignalSet

_YELLOW_S = (3.0, 6.0)  # MUTCD 11th ed. §4F.17
_MIRRORED = {"left": "right", "right": "left"}
_CLOSE = 0.02  # of a housing's width and height: lamps that stand in one place


def lint_signals(signals: SignalSet) -> list[str]:
    """Look through a description; what cannot be at all was refused when it was read.

    Returns:
        A sentence for each oddity: which field, what is odd, and what may be meant.
    """
    return [
        f"types.{name}.{text}"
        for name, light_type in signals.types.items()
        for text in (*_lamps(light_type), *_mirrors(light_type), *_durations(light_type), *_successions(light_type))
    ]


def _lamps(light_type: LightType) -> Iterator[str]:
    used = {lamp for state in light_type.states.values() for lamp in state.lit}
    for lamp in light_type.lamps:
        if lamp not in used:
            yield f"lamps.{lamp}: no class lights it; is a class missing?"
    shown: dict[frozenset[str], str] = {}
    for name, state in light_type.states.items():
        lit = frozenset(state.lit)
        if lit in shown:
            yield f"states.{name}.lit: shows the same as '{shown[lit]}'; a detector cannot tell them apart"
        shown.setdefault(lit, name)
        if not lit and name not in {pair.off for pair in light_type.flashing}:
            yield f"states.{name}.lit: a dark class that no flashing pair has as its off state; add the pair"


def _mirrors(light_type: LightType) -> Iterator[str]:
    for name, state in light_type.states.items():
        reflected = {_place(_reflected(light_type.lamps[lamp])) for lamp in state.lit}
        shown = next(
            (
                other
                for other, its in light_type.states.items()
                if {_place(light_type.lamps[lamp]) for lamp in its.lit} == reflected
            ),
            None,
        )
        if state.mirror is None and shown is not None:
            yield f"states.{name}.mirror: is null, but its mirror image shows '{shown}'"
        elif state.mirror in light_type.states and shown is not None and shown != state.mirror:
            yield f"states.{name}.mirror: is '{state.mirror}', but its mirror image shows '{shown}'"
        elif state.mirror in light_type.states and shown is None:
            yield f"states.{name}.mirror: is '{state.mirror}', but no class lights the lamps of its mirror image"


def _durations(light_type: LightType) -> Iterator[str]:
    low_s, high_s = _YELLOW_S
    flashing = {name for pair in light_type.flashing for name in (pair.on, pair.off)}
    for name, state in light_type.states.items():
        meanings = {light_type.lamps[lamp].meaning for lamp in state.lit}
        if "caution" not in meanings or name in flashing:
            continue
        if not low_s <= state.mean_s <= high_s:
            yield f"states.{name}.mean_s: a steady yellow lasts {low_s:g} to {high_s:g} s, got {state.mean_s:g}"
        elif state.min_s == 0:
            yield f"states.{name}.min_s: a steady yellow has a least duration, e.g. {low_s:g} s"


def _successions(light_type: LightType) -> Iterator[str]:
    dark = {pair.off for pair in light_type.flashing}
    for name, state in light_type.states.items():
        before = _told(light_type, name)
        for successor in state.next:
            after = _told(light_type, successor)
            for movement, meaning in before.items():
                if meaning == "go" and after.get(movement) == "stop" and successor not in dark:
                    yield f"states.{name}.next: '{successor}' stops {movement} without a yellow in between"
                if meaning == "stop" and after.get(movement) == "caution" and not _flashes(light_type, successor):
                    yield f"states.{name}.next: '{successor}' is yellow for {movement} right after stop"


def _told(light_type: LightType, class_name: str) -> dict[str, str]:
    order = ("stop", "caution", "go")
    told: dict[str, str] = {}
    for lamp in (light_type.lamps[name] for name in light_type.states[class_name].lit):
        for movement in lamp.movements:
            told[movement] = max(told.get(movement, "stop"), lamp.meaning, key=order.index)
    return told


def _flashes(light_type: LightType, class_name: str) -> bool:
    return any(class_name == pair.on for pair in light_type.flashing)


def _reflected(lamp: Lamp) -> Lamp:
    across, down = lamp.center
    shape = _MIRRORED.get(lamp.shape, lamp.shape)
    return lamp.model_copy(update={"center": (1 - across, down), "shape": shape})


def _place(lamp: Lamp) -> tuple[str, str, int, int]:
    across, down = lamp.center
    return lamp.color, lamp.shape, round(across / _CLOSE), round(down / _CLOSE)
