"""Which k and η bring each model nearest to the twelve numbers of the paper's section 3, and how near?

    python benchmarks/section3_fit.py

Least squares of the differences in %, from two starts. The best pair of `cosserat`, rounded, is the "fit" of
data_samples/sweeps/yin2020_section3.toml; it stands there as a fit, nothing else uses it.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from pipeline.keys import SetKeys
from pipeline.sweep import Sweep, load_sweep, quoted_rows, run_sweep

SWEEP = Path(__file__).parents[1] / "data_samples/sweeps/yin2020_section3.toml"
STARTS = ((1.0, 1.0), (-1.2, 0.75))


def differences(sweep: Sweep, model: str) -> Callable[[np.ndarray], np.ndarray]:
    """Differences from the quoted numbers in % as a function of (k, η), solving the quoted scenes only."""
    quoted = {(q.study, q.value) for q in sweep.quoted}
    studies = [
        study.model_copy(update={"values": [v for v in study.values if (study.name, v) in quoted]})
        for study in sweep.studies
    ]
    few = replace(sweep, models=(model,), source_model=model, studies=tuple(s for s in studies if s.values))

    def of(pair: np.ndarray) -> np.ndarray:
        one = replace(few, sets=(SetKeys(name="trial", k=float(pair[0]), eta=float(pair[1]), note=""),))
        return np.array([row.difference_percent for row in quoted_rows(one, run_sweep(one))])

    return of


def main() -> None:
    sweep = load_sweep(SWEEP)
    print("model        start           k        eta      rms %   largest %")
    for model in ("cosserat", "cosserat-fd", "flexible", "kirchhoff"):
        for start in STARTS:
            found = least_squares(differences(sweep, model), start, diff_step=1e-3)
            rms, largest = np.sqrt(np.mean(found.fun**2)), np.max(np.abs(found.fun))
            print(f"{model:12s} {start!s:14s} {found.x[0]:7.3f} {found.x[1]:8.3f} {rms:8.2f} {largest:9.2f}")


if __name__ == "__main__":
    main()
