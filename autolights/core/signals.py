"""The signal description: which lights exist, which states they show, and which state may follow which.

A description is data (``configs/signals/*.yaml``). From it come the type of a class, the structure of the HMM, flips
that are safe for training, size priors, the simulator's pictures and what counts as an unsafe error.
"""

from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from autolights.core.arrays import FloatArray
from autolights.core.config import Config, load_config

Color = Literal["red", "yellow", "green"]
Shape = Literal["ball", "left", "right", "straight"]
Meaning = Literal["stop", "caution", "go"]


class Lamp(Config):
    """One lit element of a housing.

    Attributes:
        color: What it is made to look like.
        shape: A ball or an arrow.
        center: Across and down, as fractions of the housing's width and height seen from its front.
        movements: Whom it speaks to, e.g. ``through`` and ``left``; a ball may speak to several.
        meaning: What it says to all of them.
    """

    color: Color
    shape: Shape
    center: tuple[float, float]
    movements: tuple[str, ...] = Field(min_length=1)
    meaning: Meaning


class SignalState(Config):
    """One class of a type: what is lit, for how long, and what may come next.

    Attributes:
        lit: Names of the lamps that are lit; empty for the dark phase of a flash.
        mean_s: Expected duration in seconds, from which the HMM's rates come.
        min_s: Least duration in seconds, 0 if it may end at once. Those of a flash follow from the pair.
        next: Legal successors with their relative frequency.
        mirror: The class that its mirror image shows, or None if that is no class.
    """

    lit: tuple[str, ...]
    mean_s: float = Field(gt=0)
    min_s: float = Field(default=0.0, ge=0)
    next: dict[str, float]
    mirror: str | None


class FlashingPair(Config):
    """Two states of one type that alternate when the indication flashes.

    Attributes:
        on: The lit state.
        off: The dark state.
        reported: What the pair is called when it flashes.
        steady_on: Whether the on state is legal when steady too: only a dark phase then tells a flash.
        steady_s: Of such a pair: expected duration of the on state where it is steady. Its `mean_s` is of both.
        begins_every_s: Of such a pair: steadily lit time after which it begins to flash, on average.
        period_s: Shortest and longest legal cycle (50 to 60 a minute: 1.0 to 1.2 s).
        on_ratio: Smallest and largest legal share of the cycle in which it is lit.
    """

    on: str
    off: str
    reported: str
    steady_on: bool = False
    steady_s: float = Field(default=30.0, gt=0)
    begins_every_s: float = Field(default=300.0, gt=0)
    period_s: tuple[float, float] = (1.0, 1.2)
    on_ratio: tuple[float, float] = (1 / 2, 2 / 3)


class LightType(Config):
    """A kind of housing: its size, its lamps and its states.

    Attributes:
        width_m: Physical width of what training labels draw a box around.
        height_m: Its height.
        depth_m: Its depth.
        lamps: By name; at most one lamp stands in one place.
        lamp_diameter_m: Of the lens.
        states: By class name.
        flashing: Pairs of states that flash.
    """

    width_m: float = Field(gt=0)
    height_m: float = Field(gt=0)
    depth_m: float = Field(gt=0)
    lamp_diameter_m: float = Field(default=0.3, gt=0)
    lamps: dict[str, Lamp]
    states: dict[str, SignalState]
    flashing: tuple[FlashingPair, ...] = ()

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Width, height, depth in metres."""
        return (self.width_m, self.height_m, self.depth_m)


class SignalSet(Config):
    """A whole signal description.

    Attributes:
        name: Of the description.
        classes: All class names in the detector's order.
        types: By name.
    """

    name: str
    description: str = ""
    classes: tuple[str, ...]
    types: dict[str, LightType]

    @model_validator(mode="after")
    def _check(self) -> Self:
        owner: dict[str, str] = {}
        for type_name, light_type in self.types.items():
            for class_name, state in light_type.states.items():
                if class_name in owner:
                    raise ValueError(f"class '{class_name}' belongs to types '{owner[class_name]}' and '{type_name}'")
                owner[class_name] = type_name
                for lamp in state.lit:
                    if lamp not in light_type.lamps:
                        raise ValueError(f"class '{class_name}' lights lamp '{lamp}', which type '{type_name}' lacks")
                for successor, weight in state.next.items():
                    if successor not in light_type.states or successor == class_name:
                        raise ValueError(f"class '{class_name}' cannot be followed by '{successor}'")
                    if not weight > 0:
                        raise ValueError(f"class '{class_name}': the weight of '{successor}' must be positive")
                if not state.next and len(light_type.states) > 1:
                    raise ValueError(f"class '{class_name}' has no successor: it could never be left")
                if state.min_s > state.mean_s:
                    raise ValueError(
                        f"class '{class_name}': its least duration min_s of {state.min_s:g} s is above its expected "
                        f"one, mean_s of {state.mean_s:g} s"
                    )
            _check_reachable(type_name, light_type)
            for pair in light_type.flashing:
                for class_name in (pair.on, pair.off, pair.reported):
                    if class_name not in light_type.states:
                        raise ValueError(f"flashing pair of type '{type_name}' names the unknown class '{class_name}'")
                _check_pair(type_name, light_type, pair)
        if sorted(owner) != sorted(self.classes):
            odd = set(owner) ^ set(self.classes)
            raise ValueError(f"classes and the states of all types must be the same names; only in one: {sorted(odd)}")
        for type_name, light_type in self.types.items():
            for class_name, state in light_type.states.items():
                if state.mirror is not None and state.mirror not in owner:
                    raise ValueError(f"class '{class_name}' of '{type_name}': unknown mirror class '{state.mirror}'")
        return self

    @cached_property
    def type_of(self) -> dict[str, str]:
        """Class name → type name."""
        return {name: kind for kind, light_type in self.types.items() for name in light_type.states}

    @cached_property
    def class_ids(self) -> dict[str, int]:
        """Class name → index in the detector's output."""
        return {name: i for i, name in enumerate(self.classes)}

    def states_of(self, type_name: str) -> tuple[str, ...]:
        """Class names of a type, in the detector's order."""
        return tuple(name for name in self.classes if self.type_of[name] == type_name)

    def state(self, class_name: str) -> SignalState:
        """The state of a class."""
        return self.types[self.type_of[class_name]].states[class_name]

    def mirror_ids(self) -> tuple[int | None, ...]:
        """For each class index the index of its mirror image, or None if that is no class."""
        mirrors = (self.state(name).mirror for name in self.classes)
        return tuple(None if mirror is None else self.class_ids[mirror] for mirror in mirrors)

    def reported(self, class_name: str) -> str:
        """The name under which scores compare a state: a flashing pair's dark phase counts as the pair."""
        for pair in self.types[self.type_of[class_name]].flashing:
            if class_name == pair.off:
                return pair.reported
        return class_name

    def meanings(self, class_name: str) -> dict[str, Meaning]:
        """What a state says to each movement: the most permissive of its lit lamps."""
        order: tuple[Meaning, ...] = ("stop", "caution", "go")
        lamps = self.types[self.type_of[class_name]].lamps
        said: dict[str, Meaning] = {}
        for lamp in (lamps[name] for name in self.state(class_name).lit):
            for movement in lamp.movements:
                said[movement] = max(said.get(movement, "stop"), lamp.meaning, key=order.index)
        return said

    def rates(self, type_name: str) -> FloatArray:
        """Generator Q of the type's Markov chain: (k, k) per second, rows sum to 0.

        A state is left at 1 / mean duration, towards its successors in proportion to their weights.
        """
        states = self.states_of(type_name)
        matrix = np.zeros((len(states), len(states)))
        for i, name in enumerate(states):
            state = self.state(name)
            total = sum(state.next.values())
            for successor, weight in state.next.items():
                matrix[i, states.index(successor)] = weight / total / state.mean_s
        return matrix - np.diag(matrix.sum(axis=1))

    def sizes_m(self, type_names: Iterable[str]) -> FloatArray:
        """(n, 3) width, height, depth of the named types."""
        return np.array([self.types[name].size_m for name in type_names], dtype=np.float64).reshape(-1, 3)


def load_signals(path: Path | str = "signals/autolights_13") -> SignalSet:
    """Read a signal description: a file, or the name of a shipped one."""
    return load_config(path, SignalSet)


def _check_pair(type_name: str, light_type: LightType, pair: FlashingPair) -> None:
    on, off = light_type.states[pair.on], light_type.states[pair.off]
    what = f"flashing pair '{pair.on}', '{pair.off}' of type '{type_name}'"
    if pair.reported not in (pair.on, pair.off):
        raise ValueError(f"{what} is reported as '{pair.reported}', which is neither of them")
    if off.lit or not on.lit:
        raise ValueError(f"{what}: the on state must light a lamp and the off state none, a flash needs a dark class")
    if pair.off not in on.next or pair.on not in off.next:
        raise ValueError(f"{what} cannot alternate: each must be among the successors (next) of the other")
    if not 0 < pair.period_s[0] <= pair.period_s[1]:
        raise ValueError(f"{what}: period_s must rise from above 0, got {list(pair.period_s)}")
    if not 0 < pair.on_ratio[0] <= pair.on_ratio[1] < 1:
        raise ValueError(f"{what}: on_ratio must rise within (0, 1), got {list(pair.on_ratio)}")


def _check_reachable(type_name: str, light_type: LightType) -> None:
    for start in light_type.states:
        reached, frontier = {start}, [start]
        while frontier:
            for successor in light_type.states[frontier.pop()].next:
                if successor not in reached:
                    reached.add(successor)
                    frontier.append(successor)
        missing = sorted(set(light_type.states) - reached)
        if missing:
            raise ValueError(f"type '{type_name}': class '{missing[0]}' can never follow class '{start}'")
