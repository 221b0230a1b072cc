"""The keys of a winding file, and the scene in SI that they make. Units stand in the keys."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints, field_validator

from models.winding.scene import WindingScene
from pipeline.keys import Keys, Name, StrictNumber

Positive = Annotated[StrictNumber, Field(gt=0)]
Label = Annotated[str, StringConstraints(min_length=1, max_length=60, pattern=r"^[^\x00-\x1f]+$")]
"""A case's name: words in one line."""


class WindKeys(Keys):
    """One winding scene. What may be left out has the default of `WindingScene`, which gives its evidence."""

    tex: Positive
    drum_rpm: Positive | None = None
    """Speed of the groove drum, a label: the yarn's speed is `speed_m_s`."""
    modulus_N_per_tex: Positive
    diameter_mm: StrictNumber | None = None
    """Left out: 0.037 √tex."""
    bending_share: Annotated[StrictNumber, Field(ge=0, le=1)] = 1.0
    """Bending stiffness over that of a solid circle."""
    prony_weights: tuple[StrictNumber, ...] | None = None
    prony_times_s: tuple[StrictNumber, ...] | None = None
    transverse_stiffness_N_per_mm2: StrictNumber | None = None
    grip_length_mm: StrictNumber | None = None
    contact_damping_ratio: StrictNumber | None = None
    friction_static: StrictNumber | None = None
    friction_dynamic: StrictNumber | None = None
    speed_m_s: StrictNumber
    speed_rise_s: StrictNumber | None = None
    speed_slope_m_per_s2: StrictNumber | None = None
    tension_cN: StrictNumber
    tension_slope_cN_per_s: StrictNumber | None = None
    feed: Literal["active", "tail"] | None = None
    feed_length_m: StrictNumber | None = None
    guide_distance_mm: StrictNumber | None = None
    guide_clearance_mm: StrictNumber | None = None
    guide_friction: StrictNumber | None = None
    winding_angle_deg: StrictNumber | None = None
    turns_per_cycle: StrictNumber | None = None
    reversal_share: StrictNumber | None = None
    bobbin_diameter_mm: StrictNumber | None = None
    cone_angle_deg: StrictNumber | None = None
    duration_s: StrictNumber | None = None
    element_mm: StrictNumber | None = None
    time_step_us: StrictNumber | None = None
    mode: Literal["auto", "fast", "reference"] | None = None
    wanted: Literal["span", "layers"] | None = None

    def scene(self) -> WindingScene:
        """The scene in SI.

        Raises
        ------
        ValueError
            If a value has no physical meaning; the message names the key as the user wrote it.
        """
        diameter_mm = 0.037 * math.sqrt(self.tex) if self.diameter_mm is None else self.diameter_mm
        stiffness = self.modulus_N_per_tex * self.tex
        given: dict[str, Any] = {
            field: _to_si(getattr(self, key), per_unit)
            for key, (field, per_unit) in FIELDS.items()
            if getattr(self, key) is not None
        }
        given |= {
            "diameter": diameter_mm * 1e-3,
            "axial_stiffness": stiffness,
            "bending_stiffness": self.bending_share * stiffness * (diameter_mm * 1e-3) ** 2 / 16,
        }
        try:
            return WindingScene(**given)
        except ValueError as error:
            name, right = str(error).split(" = ", 1)[0], str(error).split(": ", 1)[1]
            if name == "axial_stiffness":
                key, right = "modulus_N_per_tex", f"makes EA = {stiffness:g} N, which {right}"
            else:
                key = next(key for key, (field, _) in FIELDS.items() if field == name)
            raise ValueError(f"{key} = {written(getattr(self, key, None))}: {right}") from None

    def value(self, key: str) -> Any:
        """What a key says, in its unit; where it is left out, what `WindingScene` then takes."""
        given = getattr(self, key)
        if given is not None or key not in FIELDS:
            return given
        field, per_unit = FIELDS[key]
        taken = getattr(self.scene(), field)
        return taken / per_unit if isinstance(taken, float) else taken


FIELDS: Mapping[str, tuple[str, float]] = {
    "tex": ("linear_density", 1e-6),
    "diameter_mm": ("diameter", 1e-3),
    "prony_weights": ("prony_weights", 1.0),
    "prony_times_s": ("prony_times", 1.0),
    "transverse_stiffness_N_per_mm2": ("transverse_stiffness", 1e6),
    "grip_length_mm": ("grip_length", 1e-3),
    "contact_damping_ratio": ("contact_damping", 1.0),
    "friction_static": ("friction_static", 1.0),
    "friction_dynamic": ("friction_dynamic", 1.0),
    "speed_m_s": ("speed", 1.0),
    "speed_rise_s": ("speed_rise", 1.0),
    "speed_slope_m_per_s2": ("speed_slope", 1.0),
    "tension_cN": ("tension", 1e-2),
    "tension_slope_cN_per_s": ("tension_slope", 1e-2),
    "feed": ("feed", 1.0),
    "feed_length_m": ("feed_length", 1.0),
    "guide_distance_mm": ("guide_distance", 1e-3),
    "guide_clearance_mm": ("guide_clearance", 1e-3),
    "guide_friction": ("guide_friction", 1.0),
    "winding_angle_deg": ("winding_angle", math.radians(1)),
    "turns_per_cycle": ("turns_per_cycle", 1.0),
    "reversal_share": ("reversal", 1.0),
    "bobbin_diameter_mm": ("bobbin_radius", 0.5e-3),
    "cone_angle_deg": ("cone_angle", math.radians(1)),
    "duration_s": ("duration", 1.0),
    "element_mm": ("element_length", 1e-3),
    "time_step_us": ("time_step", 1e-6),
    "mode": ("mode", 1.0),
    "wanted": ("wanted", 1.0),
}
"""Key → field of `WindingScene` and SI units per unit of the key. The bobbin's diameter becomes its radius here."""


def _to_si(value: Any, per_unit: float) -> Any:
    return value * per_unit if isinstance(value, float | int) else value


def written(value: Any) -> str:
    """A key's value in words: '0.4', '0.123, 0', 'tail', 'left out'."""
    if isinstance(value, list | tuple):
        return ", ".join(map(written, value))
    if value is None:
        return "left out"
    return f"{value:g}" if isinstance(value, float | int) else str(value)


class LogKeys(Keys):
    """A measured tension log of a case, and how to read it."""

    file: str
    profile: str = "plain-csv"
    channel: str | None = None
    start_s: StrictNumber = 0.0
    """Time of the log at which the winding starts."""


class WindCaseKeys(WindKeys):
    """One case of a winding file: its own keys and those of [scene]."""

    name: Label
    log: LogKeys | None = None

    @field_validator("log", mode="before")
    @classmethod
    def _bare_name(cls, given: Any) -> Any:
        return {"file": given} if isinstance(given, str) else given


class VaryKeys(Keys):
    """One parameter that is varied about one case: a key of `WindKeys` and the values that it takes."""

    name: Annotated[str, Field(min_length=1)]
    case: str
    parameter: str
    values: Annotated[list[Any], Field(min_length=1)]
    note: str = ""


class WindFileKeys(Keys):
    """A winding file."""

    name: Name
    title: str
    source: str
    notes: tuple[str, ...] = ()
    scene: Annotated[dict[str, Any], Field(default_factory=dict)]
    """Keys of `WindKeys` that all cases share."""
    cases: Annotated[list[dict[str, Any]], Field(min_length=1)]
    """Each the keys of `WindCaseKeys`, which go before those of [scene]."""
    package_case: str | None = None
    """The case whose package is drawn; left out: the last."""
    vary: tuple[VaryKeys, ...] = ()
