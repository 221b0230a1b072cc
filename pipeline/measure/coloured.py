"""Standard uncertainty of a fitted parameter where what the fit leaves is correlated, as coloured noise is.

A parameter fitted by least squares is off by Σ a_i r_i, where r is what the model does not hold at pixel i and a the
parameter's influence. Fibres are longer than wide and a background has things in it: pixels near each other are off by
about the same, and a variance that takes them for independent is far too small. With C the covariance of what the fit
leaves, over the distance of two pixels,

    u² = Σ_d C(d) A(d),   A(d) = Σ_i a_i a_{i+d}.

C is estimated from the same residuals, Σ_i r_i r_{i+d} over the number of pixels: falling short at long distances, so
that u² is a sum of squares (Parzen, Ann. Math. Stat. 28, 1957). By Parseval's theorem that sum is one over wave numbers
of two periodograms: it is the residuals' power where the parameter is sensitive that counts.
"""

import numpy as np
import scipy.fft

from pipeline.measure.lines import Image
from pipeline.records import Array


def coloured_u(influence: Array | Image, rest: Array | Image) -> float:
    """Return the standard uncertainty of a parameter.

    Parameters
    ----------
    influence : a, the parameter's change per unit of a pixel's level, shape (rows, columns), 0 where nothing is fitted.
    rest : what the fit leaves, of about equal spread all over, 0 where nothing is fitted.
    """
    inside = int(np.count_nonzero(influence))
    if not inside:
        return 0.0
    # twice as long as the picture, so that its ends do not meet
    size = [scipy.fft.next_fast_len(2 * n - 1, real=True) for n in influence.shape]
    power = [np.abs(scipy.fft.rfft2(part, size)) ** 2 for part in (influence, rest)]
    product = power[0] * power[1]
    # each wave number but those at the ends stands for two
    whole = 2 * float(product.sum()) - float(product[:, 0].sum())
    if size[1] % 2 == 0:
        whole -= float(product[:, -1].sum())
    return (whole / (size[0] * size[1] * inside)) ** 0.5
