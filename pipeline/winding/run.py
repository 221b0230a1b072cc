"""Winding a study: its cases side by side, and what each result says of its span and its layers."""

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from models.winding.result import Checkpoint, WindingResult
from models.winding.solve import wind
from pipeline.records import Array
from pipeline.winding import metric
from pipeline.winding.metric import Errors, Span
from pipeline.winding.study import WindingCase, WindingStudy

CORES = 2
Report = Callable[[float, float], None]
"""Called with the share of the work that is done, 0 to 1, and the estimate of the time left [s]."""


@dataclass(frozen=True, slots=True)
class Row:
    """One case or variant, wound. A failed one keeps its place and its reason."""

    case: WindingCase
    result: WindingResult
    extremes: NDArray[np.bool_]
    """Points of the result's series that are extremes of the guide's collision, shape (m,)."""
    span: Span
    sample_time: Array
    """[s], shape (k,)."""
    samples: Array
    """The paper's samples [N], shape (k,)."""
    errors: Errors
    errors_all: Errors
    """The same with nothing left out."""

    @property
    def name(self) -> str:
        """Of the case, with what is varied."""
        return self.case.label

    @property
    def variant(self) -> bool:
        """Whether something is varied."""
        return self.case.variant is not None

    @property
    def ok(self) -> bool:
        """Whether the run was completed."""
        return self.result.outcome.ok

    @property
    def tex(self) -> float:
        """[tex]."""
        return self.case.keys.tex

    @property
    def speed(self) -> float:
        """V [m/s] of the yarn."""
        return self.case.scene.speed

    @property
    def end_tension(self) -> float:
        """T₀ [N] at the start."""
        return self.case.scene.tension

    @property
    def layers(self) -> Array:
        """T/T₀ of the complete layers, innermost first, shape (k,)."""
        return self.result.layers_T_over_T0


def run_winding(
    study: WindingStudy,
    *,
    progress: Report | None = None,
    checkpoints: Mapping[str, Checkpoint] | None = None,
    cores: int = CORES,
) -> tuple[Row, ...]:
    """Wind every case and variant, `cores` at a time, in the order of the study.

    Threads, not processes: the models' machine code runs without the interpreter's lock.

    Parameters
    ----------
    checkpoints : by label of the case, where its run keeps its state.
    """
    tracker = _Tracker(len(study.cases), progress)
    kept = checkpoints or {}
    with ThreadPoolExecutor(cores) as pool:
        running = {
            pool.submit(wind, case.scene, progress=tracker.of(index), checkpoint=kept.get(case.label)): index
            for index, case in enumerate(study.cases)
        }
        try:
            for done in as_completed(running):
                done.result()
        except BaseException:  # Ctrl-C too: runs of minutes must not be waited for
            tracker.stop()
            pool.shutdown(cancel_futures=True)
            raise
    results = {index: done.result() for done, index in running.items()}
    return tuple(row(case, results[index]) for index, case in enumerate(study.cases))


def row(case: WindingCase, result: WindingResult) -> Row:
    """What a result says, by the paper's metric; against the case's log where it has one, against T₀ otherwise."""
    at, tension = result.time, result.span_tension
    extremes = metric.collision_extremes(at, tension, turns(result))
    times = metric.sample_times(case.scene.duration)
    samples = metric.sampled(at, tension, ~extremes, times)
    every = metric.sampled(at, tension, np.ones_like(extremes), times)
    if case.log is None:
        reference, said = case.scene.tension + case.scene.tension_slope * times, "T₀"
    else:
        reference, said = metric.measured_at(case.log.raw, times, case.log.start), case.log.raw.source.name
    return Row(
        case=case,
        result=result,
        extremes=extremes,
        span=metric.span_statistics(at, tension, _settled(result)),
        sample_time=times,
        samples=samples,
        errors=metric.errors(samples, reference, said),
        errors_all=metric.errors(every, reference, said),
    )


def turns(result: WindingResult) -> Array:
    """Times [s] at which the guide turns round: where its phase passes a multiple of a half."""
    half = np.floor(2 * result.guide_phase + 1e-9)
    return result.time[1:][np.diff(half) > 0]


def _settled(result: WindingResult) -> float:
    """Time [s] from which the span counts as settled: after the first guide cycle; in a short run, after the start."""
    whole = result.time[result.guide_phase >= 1]
    if whole.size > result.time.size / 2:
        return float(whole[0])
    return result.scene.speed_rise


def failed(rows: Sequence[Row]) -> list[str]:
    """One line for each run that was not completed."""
    return [f"{r.name}: {r.result.outcome.name.lower()}: {r.result.message}" for r in rows if not r.ok]


class _Stopped(Exception):
    """Ends a run whose neighbour has failed or been interrupted."""


class _Tracker:
    """Adds up what parallel runs say of themselves."""

    def __init__(self, runs: int, report: Report | None):
        self._shares = np.zeros(runs)
        self._report = report
        self._start = time.monotonic()
        self._lock = Lock()
        self._stopped = False

    def stop(self) -> None:
        """Let every run end when it next tells its progress."""
        self._stopped = True

    def of(self, index: int) -> Callable[[float], None]:
        """The progress callback of one run."""

        def told(share: float) -> None:
            if self._stopped:
                raise _Stopped
            with self._lock:
                self._shares[index] = share
                total = float(self._shares.mean())
            if total > 0 and self._report is not None:
                self._report(total, (time.monotonic() - self._start) * (1 / total - 1))

        return told
