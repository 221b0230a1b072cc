"""The winding scene in SI: everything that decides the answer, stated explicitly and with its evidence.

The bobbin turns about e_z, its axis. The yarn comes from the feed along +e_x, passes the traversing guide at
x = −guide_distance and touches the bobbin on top, at x = 0, y = bobbin radius + yarn radius. The guide moves along e_z.

Source: "Yarn winding with 3-D beam elements" (the paper); its tables are lost. Each field says whether the paper gives
it [P] or it is an assumption [A] that a user with a machine should replace.
"""

import math
from dataclasses import dataclass
from typing import Literal

from models.winding.drive import travel

Mode = Literal["auto", "fast", "reference"]
Feed = Literal["active", "tail"]
Wanted = Literal["span", "layers"]

SHORTEST, LONGEST = 1e-3, 3600.0
"""Of a run [s]: one sample of its tension, and as many as may be kept."""
SMALLEST_STEP = 1e-10
"""Of time [s]: the shortest run then takes ten million steps."""
MOST_ELEMENTS = 100_000
"""Elements of wound yarn, 200 m of 2 mm: crossings, and with them memory, grow with their square, to about 0.7 GB."""
LIMITS = {
    "linear_density": (1e-8, 1e-2, "kg/m"),
    "diameter": (1e-6, 1e-2, "m"),
    "axial_stiffness": (1e-3, 1e6, "N"),
    "transverse_stiffness": (1e3, 1e12, "N/m²"),
    "grip_length": (1e-5, 1.0, "m"),
    "speed": (1e-4, 100.0, "m/s"),
    "tension": (1e-4, 1e4, "N"),
    "feed_length": (1e-3, 1e4, "m"),
    "guide_distance": (1e-3, 100.0, "m"),
    "feed_memory": (1e-6, 1e6, "s"),
    "turns_per_cycle": (0.5, 1e3, "turns"),
    "bobbin_radius": (1e-3, 10.0, "m of radius"),
    "element_length": (1e-5, 1.0, "m"),
    "duration": (SHORTEST, LONGEST, "s"),
}
"""Far beyond any yarn and winder, but within what can be computed."""
LARGEST = {
    "bending_stiffness": (10.0, "N m²"),
    "contact_damping": (10.0, "times critical"),
    "friction_static": (10.0, ""),
    "friction_dynamic": (10.0, ""),
    "speed_rise": (LONGEST, "s"),
    "guide_clearance": (1.0, "m"),
    "guide_friction": (10.0, ""),
}
"""The same for what may be 0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WindingScene:
    """One winding run in SI units.

    Raises
    ------
    ValueError
        If a value is not finite or outside the range in which the scene has a meaning; the message names the field,
        the value and the range.
    """

    # Yarn
    linear_density: float
    """ρ [kg/m]; 1 tex = 1e-6 kg/m. [P] 32.8, 65.6, 131.2 tex."""
    diameter: float
    """d [m]. [A] 0.037 mm √tex, the usual estimate for cotton; the paper's formula is lost."""
    axial_stiffness: float
    """EA [N], instantaneous. [A] 3.0, 2.7, 2.4 N/tex times the fineness."""
    bending_stiffness: float
    """B [N m²]. [A] solid circle, EA d²/16: an upper bound, fibres slide in a real yarn."""
    prony_weights: tuple[float, ...] = (0.123, 0.0)
    """g_k, share of EA that relaxes, Σ g_k < 1. [P] gives a₁ = 0.123 and a₂ = 924.09; the second cannot be a weight and
    is 0 here [A]."""
    prony_times: tuple[float, ...] = (3.53, 3.53)
    """τ_k [s]. [P]."""
    transverse_stiffness: float = 2.4e7
    """K_t [N/m²]: contact force per length of yarn over approach, yarn against a rigid surface. [A] decides the tension
    of the layers. 2.4e7 is stiff (the yarn sinks by 0.2 % of its diameter), 4e5 soft (10 %); calibrate it."""
    grip_length: float = 4e-3
    """√(EA/K_g) [m], K_g the stiffness of the bobbin's grip along its surface per length of yarn: over this length of
    held yarn a change of tension dies out. [P] rough contact, no slip: 0 would be rigid; [A] 4 mm, two of the paper's
    elements. It decides how much slack the span still draws out of yarn that sinks while it lands."""
    contact_damping: float = 0.2
    """Damping of the transverse contact over critical. [A]."""
    friction_static: float = 0.30
    """Yarn on yarn. [P]."""
    friction_dynamic: float = 0.25
    """Yarn on yarn. [P]."""

    # Drive and feed
    speed: float
    """V [m/s] of the yarn at full speed. [A] 3.0, 4.8, 6.0 m/s for 500, 800, 1000 r/min, from [P] 9 m in 1.5 s."""
    speed_rise: float = 0.05
    """Duration of the start from rest [s], a half cosine. [A] A step would add ρcV, 1.2 N at 6 m/s: slack and shock."""
    speed_slope: float = 0.0
    """Change of V per second after that [m/s²]. [A]."""
    tension: float
    """T₀ [N], end tension. [P] 0.30, 0.50, 0.50 N."""
    tension_slope: float = 0.0
    """Change of T₀ per second [N/s]. [A] The measured rise in the paper's experiments would enter here."""
    feed: Feed = "active"
    """`active`: an eyelet upstream with a matched feed that keeps the mean tension; `tail`: a free straight tail pulled
    by T₀ at its end [P], whose longitudinal standing waves make most of the fluctuation."""
    feed_length: float = 0.30
    """Eyelet to guide [m] with the active feed [A]; with `tail` the length of yarn upstream of the guide [P] 9 m: it
    must be longer than what is wound."""

    feed_memory: float = 0.02
    """Time constant [s] over which the active feed forgets a change of speed: faster changes meet the impedance ρc of
    the yarn upstream, slower ones T₀ alone. [A]."""

    # Guide and traverse
    guide_distance: float = 0.06
    """Guide to the bobbin's topmost line [m]. [A]."""
    guide_clearance: float = 0.25e-3
    """Play of the yarn's centre line in the eye of the guide [m]. [A]."""
    guide_friction: float = 0.0
    """Yarn on guide. [P] frictionless."""
    winding_angle: float = math.radians(12)
    """α [rad], between yarn and circumference at the bobbin's mean radius. [P] 12°."""
    turns_per_cycle: float = 4.55
    """Bobbin turns per guide cycle, forth and back; the fraction 0.55 is the [P] loop displacement, 198°; 4 is [A]."""
    reversal: float = 0.02
    """Share of a cycle that each reversal of the guide takes. [A]."""
    bobbin_radius: float = 0.03
    """Mean radius over the stroke [m]. [A]."""
    cone_angle: float = 0.0
    """Half-angle of the bobbin [rad], the radius grows along +e_z. [P] 0: the paper replaces its cones by cylinders."""

    # Computation
    duration: float = 1.5
    """[s]. [P]."""
    element_length: float = 2e-3
    """Natural length of an element [m]. [P]."""
    time_step: float | None = None
    """Reference mode [s]; None: 0.9 of the limit of stability."""
    mode: Mode = "auto"
    """`fast`: lay-path kinematics; `reference`: explicit dynamics; `auto`: the cheaper that answers `wanted`."""
    wanted: Wanted = "span"
    """What `auto` must answer: the tension between guide and bobbin, or the tension of the layers as well."""

    def __post_init__(self) -> None:
        for name, (low, high, unit) in LIMITS.items():
            self._require(name, 0.0 < getattr(self, name) < math.inf, "must be greater than 0")
            self._require(name, low <= getattr(self, name) <= high, f"must be {low:g} to {high:g} {unit}")
        for name, (high, unit) in LARGEST.items():
            self._require(name, 0.0 <= getattr(self, name) < math.inf, "must be 0 or greater")
            self._require(name, getattr(self, name) <= high, f"must be at most {high:g} {unit}".rstrip())
        for name in ("speed_slope", "tension_slope"):
            self._require(name, math.isfinite(getattr(self, name)), "must be a finite number")
        self._require("friction_dynamic", self.friction_dynamic <= self.friction_static, "must not exceed the static")
        self._require("winding_angle", 0.0 < self.winding_angle < math.pi / 4, "must be between 0 and π/4 rad (45°)")
        self._require("reversal", 0.0 < self.reversal <= 0.25, "must be above 0 and at most 0.25")
        self._require("prony_times", len(self.prony_times) == len(self.prony_weights), "must pair with prony_weights")
        self._require("prony_times", all(0.0 < t < math.inf for t in self.prony_times), "must be greater than 0")
        weights = self.prony_weights
        self._require("prony_weights", all(g >= 0 for g in weights) and sum(weights) < 1, "must be ≥ 0 with a sum < 1")
        smallest = self.bobbin_radius - math.tan(abs(self.cone_angle)) * self.stroke / 2
        self._require("cone_angle", abs(self.cone_angle) < math.pi / 4 and smallest > 0, "must leave a radius above 0")
        until_end = "must leave it above 0 to the end of the run"
        self._require("speed_slope", self.speed + self.speed_slope * self.duration > 0, until_end)
        self._require("tension_slope", self.tension + self.tension_slope * self.duration > 0, until_end)
        lowest = min(self.tension, self.tension + self.tension_slope * self.duration)
        flies = self.linear_density * max(self.speed, self.speed + self.speed_slope * self.duration) ** 2
        self._require("tension", lowest > flies, f"must exceed ρV² = {flies:.3g} N, or the yarn flies off the bobbin")
        elements = self.wound_length / self.element_length
        fits = elements <= MOST_ELEMENTS
        self._require("duration", fits, f"winds {elements:.3g} elements of yarn, at most {MOST_ELEMENTS} are possible")
        free = self.guide_distance + self.feed_length
        fits = free <= MOST_ELEMENTS * self.element_length
        self._require("feed_length", fits, f"{free:g} m of free yarn are more than {MOST_ELEMENTS} elements")
        self._require("element_length", self.element_length > self.diameter, "must exceed the yarn's diameter")
        self._require("element_length", 4 * self.element_length <= self.guide_distance, "must be ≤ guide_distance / 4")
        self._require(
            "element_length", 4 * self.element_length <= smallest, "must be ≤ a quarter of the bobbin's radius"
        )
        if self.time_step is not None:
            self._require("time_step", 0.0 < self.time_step < math.inf, "must be greater than 0, or None")
            self._require(
                "time_step", self.time_step >= SMALLEST_STEP, f"must be at least {SMALLEST_STEP:g} s, or None"
            )

    def _require(self, name: str, holds: bool, right: str) -> None:
        if not holds:
            raise ValueError(f"{name} = {getattr(self, name)}: {right}")

    @property
    def stroke(self) -> float:
        """Length of the guide's travel along the axis [m]: half of the axial advance of one cycle."""
        return self.turns_per_cycle * math.pi * self.bobbin_radius * math.tan(self.winding_angle)

    @property
    def wave_speed(self) -> float:
        """Speed of longitudinal waves, c = √(EA/ρ) [m/s]."""
        return math.sqrt(self.axial_stiffness / self.linear_density)

    @property
    def impedance(self) -> float:
        """ρc [kg/s]: tension per change of speed in a longitudinal wave."""
        return math.sqrt(self.axial_stiffness * self.linear_density)

    @property
    def wound_length(self) -> float:
        """Length that the drive takes in over the duration [m], without slip and strain."""
        return travel(self.duration, self.speed, self.speed_rise, self.speed_slope)[0]

    @property
    def cycles(self) -> float:
        """Guide cycles over the duration."""
        turn = 2 * math.pi * self.bobbin_radius / math.cos(self.winding_angle)
        return self.wound_length / (turn * self.turns_per_cycle)

    @property
    def softness(self) -> float:
        """EA / (R² K_t): how many times the tension's own strain a laid loop loses by sinking; ≪ 1 is stiff."""
        return self.axial_stiffness / (self.bobbin_radius**2 * self.transverse_stiffness)
