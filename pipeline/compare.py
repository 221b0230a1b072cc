"""Compare: prediction against measurement, with the uncertainty that decides whether the error can be told."""

import math
from collections.abc import Sequence

from pipeline.case import Bound, Study
from pipeline.records import Comparison, Estimate, Measured, Prediction, Quantity

UNBOUNDED = Bound(math.nan)


def compare(study: Study, measured: Sequence[Measured], predictions: Sequence[Prediction]) -> tuple[Comparison, ...]:
    """One row per case, quantity and model, in that order. A failed solve or a missing measurement keeps its row."""
    by_case = {m.case: m for m in measured}
    return tuple(
        _compare_one(
            prediction,
            quantity,
            by_case[case.name].values.get(quantity, Estimate(math.nan, reason="not measured")),
            study.bounds.get((case.name, prediction.solution.model, quantity), UNBOUNDED),
        )
        for case in study.cases
        for quantity in Quantity
        for prediction in predictions
        if prediction.case == case.name
    )


def _compare_one(prediction: Prediction, quantity: Quantity, measured: Estimate, bound: Bound) -> Comparison:
    """E = S − M and u_val = √(u_num² + u_input² + u_D²) (ASME V&V 20-2009, Eqs 1-5-1 and 1-5-10)."""
    solution, unit = prediction.solution, quantity.per_si
    S, M = quantity.of(solution.ends) * unit, measured.mean * unit
    terms = {
        "u_num": quantity.of(solution.u_num) * unit,
        "u_input": quantity.of(prediction.u_input) * unit,
        "u_D": measured.u * unit,
    }
    known = [u for u in terms.values() if math.isfinite(u)]
    return Comparison(
        case=prediction.case,
        quantity=quantity,
        model=solution.model,
        M=M,
        cv_percent=measured.cv * 100,
        S=S,
        E=S - M,
        E_percent=abs(S - M) / abs(M) * 100 if M else math.nan,
        **terms,
        u_val=math.sqrt(sum(u * u for u in known)) if known else math.nan,
        missing_u=tuple(name for name, u in terms.items() if not math.isfinite(u)),
        outcome=solution.outcome.name.lower(),
        message=solution.message or measured.reason,
        bound_percent=bound.percent,
        bound_reason=bound.reason,
    )
