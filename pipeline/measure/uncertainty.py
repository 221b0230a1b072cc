"""Uncertainty of a mean over correlated samples (GUM type A) and of several means that should agree."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from pipeline.records import Array, Estimate


def effective_count(samples: Array) -> float:
    """Number of independent samples with the same variance of the mean as these correlated ones.

    n_eff = n / (1 + 2 Σ ρ_k), the sum over lags ended by Geyer's initial positive sequence (Geyer 1992, section 3.3):
    pairs ρ_{2m} + ρ_{2m+1} are added while they stay positive. Bounded to [1, n].

    Parameters
    ----------
    samples : shape (n,), evenly spaced in time, finite.
    """
    n = samples.size
    centred = samples - samples.mean()
    if n < 3 or samples.min() == samples.max():
        return float(n)
    spectrum = np.fft.rfft(centred, 2 * n)
    autocovariance = np.fft.irfft(spectrum * np.conj(spectrum))[:n]
    rho = autocovariance / autocovariance[0]
    pairs = rho[: n - n % 2].reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(pairs <= 0)
    kept = pairs[: ends[0]] if ends.size else pairs
    time = 2 * kept.sum() - 1
    return float(np.clip(n / time, 1.0, n)) if time > 0 else float(n)


def mean_estimate(samples: Array, *, extra_u: Mapping[str, float] | None = None, reason: str = "") -> Estimate:
    """Estimate the mean of samples that may contain NaN (left out), with u = √(s²/n_eff + Σ extra_u²).

    Parameters
    ----------
    samples : shape (n,), any unit, NaN where flagged.
    extra_u : standard uncertainties common to all samples (resolution, calibration, scale) by name, same unit; NaN
        terms are not stated and left out, so say so in `reason`.
    """
    good = samples[np.isfinite(samples)]
    if good.size < 2:
        return Estimate(
            mean=float(good[0]) if good.size else math.nan,
            n=int(good.size),
            reason=reason or f"{good.size} usable samples: at least 2 are needed for an uncertainty",
        )
    n_eff = effective_count(good)
    deviation = float(good.std(ddof=1))
    mean = float(good.mean())
    terms = {"sampling": deviation / math.sqrt(n_eff)}
    terms |= {name: u for name, u in (extra_u or {}).items() if math.isfinite(u)}
    cv = abs(deviation / mean) if mean else math.nan
    u = math.hypot(*terms.values())
    return Estimate(mean=mean, u=u, cv=cv, n=int(good.size), n_eff=n_eff, reason=reason, u_terms=terms)


def combine(estimates: Sequence[Estimate]) -> Estimate:
    """Combine independent estimates of one mean (two logs, three clips) by inverse variance.

    u is the internal uncertainty 1/√Σu⁻², times the Birge ratio √(χ²/(m−1)) where that exceeds 1: estimates that
    disagree by more than they state make the result less certain, not more. The coefficient of variation is the
    root mean square of the parts'. Estimates without a mean are left out; without a u anywhere, the plain mean
    is given and u is NaN.
    """
    known = [e for e in estimates if math.isfinite(e.mean)]
    if not known:
        return estimates[0] if estimates else Estimate(mean=math.nan, n=0, reason="nothing was measured")
    if len(known) == 1:
        return known[0]
    n = sum(e.n or 0 for e in known) or None
    n_eff = float(sum(e.n_eff for e in known))
    cv = math.sqrt(sum(e.cv**2 for e in known) / len(known))
    reason = "; ".join(dict.fromkeys(part for e in known for part in e.reason.split("; ") if part))
    means = np.array([e.mean for e in known])
    u = np.array([e.u for e in known])
    if not np.all(np.isfinite(u) & (u > 0)):
        plain = "plain mean without u, because not every part has one"
        return Estimate(
            mean=float(means.mean()), cv=cv, n=n, n_eff=n_eff, reason="; ".join(filter(None, [reason, plain]))
        )
    weight = u**-2 / np.sum(u**-2)
    mean = float(weight @ means)
    birge = math.sqrt(float(np.sum(((means - mean) / u) ** 2)) / (len(known) - 1))
    return Estimate(mean, float(np.sum(u**-2) ** -0.5) * max(1.0, birge), cv, n, n_eff, reason)
