"""A made-up study for the tests of the report: round, artificial numbers, one of everything that can occur."""

import math
from dataclasses import replace

import numpy as np

from models.outcome import Ends, Outcome, Profile, Solution, Stats
from models.scene import Scene
from pipeline.records import (
    Comparison,
    Estimate,
    FrameFlag,
    Measured,
    Prediction,
    Quantity,
    RawTension,
    RawVideo,
    Results,
    Source,
    TensionFlag,
    TensionMeasurement,
    Thumbnail,
    YarnMeasurement,
)

SCENE = Scene(
    wrap_angle=math.radians(50),
    cylinder_radius=3e-3,
    yarn_radius=8e-5,
    friction=0.8,
    twist_CD=900.0,
    tension_CD=0.2,
    torsional_rigidity=5e-9,
    delivery_speed=0.2,
    cylinder_speed_ratio=2.0,
)
MODELS = ("capstan", "flexible", "cosserat", "kirchhoff")
# p3_AB [cN], T_AB [tpm], theta_B [deg]
MEASURED = {"published-1": (10.0, 1000.0, 78.0), "raw-1": (12.0, 800.0, 77.0)}
SIMULATED = {
    ("published-1", "capstan"): (8.0, 900.0, 90.0),
    ("published-1", "flexible"): (11.0, 950.0, 73.0),
    ("published-1", "cosserat"): (9.5, 1010.0, 73.5),
    ("published-1", "kirchhoff"): (10.9, 955.0, 73.25),
    ("raw-1", "capstan"): (9.0, 700.0, 90.0),
    ("raw-1", "flexible"): (12.5, 780.0, 72.0),
    ("raw-1", "kirchhoff"): (12.375, 784.0, 72.5),
}
FAILED = ("raw-1", "cosserat")
FAILURE = "residual 0.5 after 50 iterations <tol 1e-9>"
BOUND = {"flexible": 15.0, "cosserat": 5.0}
WALL = {"capstan": 1e-6, "flexible": 4e-4, "cosserat": 3e-3, "kirchhoff": 5e-3}


def prediction(case: str, model: str) -> Prediction:
    if (case, model) == FAILED:
        solution = Solution(SCENE, model, Outcome.NOT_CONVERGED, FAILURE, stats=Stats(iterations=50, residual=0.5))
        return Prediction(case, solution, Ends(), WALL[model])
    tension, twist, theta = SIMULATED[case, model]
    ends = Ends(tension / 100, twist, math.radians(theta))
    psi = np.linspace(0, SCENE.wrap_angle, 41)
    part = psi / SCENE.wrap_angle
    profile = Profile(
        psi=psi,
        theta=ends.theta_B + part * (math.pi - 2 * ends.theta_B),
        tension=ends.tension_AB + part * (SCENE.tension_CD - ends.tension_AB),
        twist=ends.twist_AB + part * (SCENE.twist_CD - ends.twist_AB),
        normal_force=np.full(41, 40.0),
        bending_moment=1e-6 * (1 + part**2) * twist / 1000,
        torsional_moment=2e-5 * (2 - part) * twist / 1000,
        z=1e-3 * np.sin(math.pi * part) * (90 - theta) / 15,
    )
    solution = Solution(
        SCENE, model, Outcome.CONVERGED, "residual 1e-12", ends, Ends(1e-6, 1e-2, 1e-6), math.pi - ends.theta_B, 12.5,
        40.0, profile, Stats(5, 1e-12, 1e-13, 1e-9, 16, 1e4),
    )  # fmt: skip
    return Prediction(case, solution, Ends(0.01, 100.0, 0.01), WALL[model])


def comparison(case: str, quantity: Quantity, model: str) -> Comparison:
    index = list(Quantity).index(quantity)
    M = MEASURED[case][index]
    missing_cv = case == "published-1" and quantity is Quantity.THETA_B
    failed = (case, model) == FAILED
    S = math.nan if failed else SIMULATED[case, model][index]
    u_D = math.nan if missing_cv else 0.05 * M
    u_input = 1.0 if quantity is Quantity.TENSION_AB else 10.0
    return Comparison(
        case=case,
        quantity=quantity,
        model=model,
        M=M,
        cv_percent=math.nan if missing_cv else 5.0,
        S=S,
        E=S - M,
        E_percent=abs(S - M) / abs(M) * 100,
        u_D=u_D,
        u_num=math.nan if failed else 0.001,
        u_input=math.nan if failed else u_input,
        u_val=math.nan if failed else math.sqrt(0.001**2 + u_input**2 + (0 if missing_cv else u_D**2)),
        missing_u=("u_D",) if missing_cv else (),
        outcome="not_converged" if failed else "converged",
        message=FAILURE if failed else "residual 1e-12",
        bound_percent=BOUND.get(model, math.nan),
        bound_reason="the published mean is itself a reading" if missing_cv and model in BOUND else "",
    )


def log(n: int = 1500) -> TensionMeasurement:
    time = np.arange(n) / 100
    tension = 0.12 + 0.006 * np.sin(2 * math.pi * time / 5) + 0.002 * np.sin(2 * math.pi * time * 7.3)
    flag = np.zeros(n, dtype=np.uint16)
    tension[300:310], flag[300:310] = math.nan, TensionFlag.MISSING
    tension[700], flag[700] = 0.2, TensionFlag.SPIKE
    flag[1000:1100] = TensionFlag.STUCK
    raw = RawTension(Source("raw-1/tension.csv", "0" * 64, 12345), "made-up", "cN", time, tension, flag, 0.001, 0.01)
    counts = {"missing": 10, "spike": 1, "stuck": 100}
    estimate = Estimate(0.12, 0.006, 0.05, n - 111, 60.0)
    return TensionMeasurement(raw, (1.0, 14.0), estimate, 100.0, 1e-5, ((5.0, 5.4),), counts)


class NoFrames:
    def __len__(self) -> int:
        return 40

    def frame(self, index: int) -> np.ndarray:
        raise AssertionError("the report must not read frames")


def clip(*, credible: bool = True) -> YarnMeasurement:
    n = 40
    time = np.arange(n) / 1000
    theta = np.radians(77 + np.sin(np.arange(n)))
    twist = 800 + 40 * np.cos(np.arange(n) / 2)
    diameter = 1.6e-4 + 4e-6 * np.sin(np.arange(n) / 3)
    flag = np.zeros(n, dtype=np.uint16)
    flag[7] = FrameFlag.NO_YARN
    theta[7] = twist[7] = diameter[7] = math.nan
    if not credible:
        twist = np.full(n, math.nan)
        flag |= np.uint16(FrameFlag.TWIST_NOT_CREDIBLE)
    rows, columns = np.mgrid[0:96, 0:128]
    distance = np.abs((rows - 48) * math.cos(0.2) + (columns - 64) * math.sin(0.2))
    image = np.where(distance < 15, 200 - 4 * distance, 30).astype(np.uint8)
    shots = tuple(
        Thumbnail(frame, image, (64.0, 48.0), 0.2, 30.0, 800.0 if credible and frame else math.nan)
        for frame in (0, 10, 20, 30)
    )
    raw = RawVideo(Source("raw-1/clip.avi", "1" * 64, 999), NoFrames(), time, 1000.0, 8, (600, 800))
    reason = "" if credible else "12 px across the yarn: twist is not credible below 20 px"
    nothing = Estimate(math.nan, reason=reason)
    summary = {
        "axis_angle": Estimate(0.2, 0.001, 0.01, 39, 20.0),
        "theta_B": Estimate(math.radians(77), 0.002, 0.01, 39, 20.0),
        "twist": Estimate(800.0, 5.0, 0.035, 39, 20.0) if credible else nothing,
        "diameter": Estimate(1.6e-4, 1e-6, 0.02, 39, 20.0),
        "hairiness": Estimate(2e3, 1e2, 0.3, 39, 20.0),
        "helix_rotation": Estimate(math.nan, n=0, reason="it turned too far"),
    }
    confidence = np.where(flag & np.uint16(FrameFlag.NO_YARN), 0.0, 0.9)
    return YarnMeasurement(
        raw, "unrolled fibres", np.full(n, 0.2), theta, twist, diameter, confidence, flag, summary,
        "Z" if credible else "", reason, np.full((n, 2), 30.0), np.full(n, 2e3), np.full(n, np.nan), np.zeros(n),
        np.full(n, 0.02), shots,
    )  # fmt: skip


def study(*, synthetic: bool = True) -> Results:
    measured = []
    for case, values in MEASURED.items():
        raw = case == "raw-1"
        estimates = {
            quantity: Estimate(
                value / quantity.per_si,
                0.05 * value / quantity.per_si if raw else math.nan,
                math.nan if not raw and quantity is Quantity.THETA_B else 0.05,
                1389 if raw else None,
                60.0 if raw else math.nan,
                "" if raw else "the source states no number of samples",
            )
            for quantity, value in zip(Quantity, values, strict=True)
        }
        measured.append(
            Measured(
                case,
                estimates,
                Estimate(1.6e-4, 1e-6, 0.02, 39, 20.0) if raw else None,
                (log(),) if raw else (),
                (clip(), clip(credible=False)) if raw else (),
            )
        )
    return Results(
        name="made-up",
        title="A made-up study & its <report>",
        source="Invented for the tests; no yarn was spun. See https://example.org/nowhere",
        synthetic=synthetic,
        notes=("The numbers are round on purpose.", "Nothing here was *measured*."),
        fitted="",
        measured=tuple(measured),
        predictions=tuple(prediction(case, model) for case in MEASURED for model in MODELS),
        comparisons=tuple(comparison(c, q, m) for c in MEASURED for q in Quantity for m in MODELS),
        published={
            "published-1": {
                Quantity.TENSION_AB: (9.6, 4.0),
                Quantity.TWIST_AB: (1020.0, 2.0),
                Quantity.THETA_B: (73.1, math.nan),
            }
        },
        provenance={"inputs": [{"name": "raw-1/tension.csv", "sha256": "0" * 64}], "versions": {"yarnval": "0.0"}},
    )


def published_only() -> Results:
    """The same study with no raw data, no published simulation, and one model."""
    whole = study(synthetic=False)
    return replace(
        whole,
        measured=tuple(replace(m, tension=(), yarn=()) for m in whole.measured),
        predictions=tuple(p for p in whole.predictions if p.solution.model == "flexible"),
        comparisons=tuple(c for c in whole.comparisons if c.model == "flexible"),
        published={},
    )
