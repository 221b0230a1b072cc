"""Wind: choose the mode, run it."""

from models.winding.fast import wind_fast
from models.winding.reference import wind_reference
from models.winding.result import Checkpoint, Progress, WindingResult
from models.winding.scene import WindingScene

SOFT = 0.1
"""Softness (`WindingScene.softness`) above which the layers lose tension by more than the fast mode gets right."""


def wind(
    scene: WindingScene, *, progress: Progress | None = None, checkpoint: Checkpoint | None = None
) -> WindingResult:
    """Wind `scene`.

    Parameters
    ----------
    progress : told the share of the work done; the time left follows from it.
    checkpoint : asked for a state to go on from, and given one about every 20 s of a reference run.

    Returns
    -------
    WindingResult
        Never raises for what the physics or the time step does: see its outcome.
    """
    if scene.mode == "fast":
        return wind_fast(scene, "asked for", progress)
    if scene.mode == "reference":
        return wind_reference(scene, "asked for", progress, checkpoint)
    if scene.wanted == "span":
        reason = "the tension of the span is wanted: its waves and the lay path give it"
        return wind_fast(scene, reason, progress)
    if scene.softness <= SOFT:
        reason = f"layers on stiff yarn are wanted: EA/(R² K_t) = {scene.softness:.3g}, at most {SOFT}"
        return wind_fast(scene, reason, progress)
    reason = f"layers on soft yarn are wanted: EA/(R² K_t) = {scene.softness:.3g}, above {SOFT}"
    return wind_reference(scene, reason, progress, checkpoint)
