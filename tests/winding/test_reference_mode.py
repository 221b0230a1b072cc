"""The reference mode: mechanics, energy, determinism, refusal of unstable steps."""

import math
from dataclasses import replace

import numpy as np
import pytest
from winding_scenes import winding_scene

from models.winding.reference import Run
from models.winding.result import Kept, WindingOutcome, WindingResult
from models.winding.scene import WindingScene
from models.winding.solve import wind
from models.winding.stepping import AT_GUIDE, GOING, LAID, PAIRS, PROBE_MARGIN, SPAN, time_step_limit


@pytest.fixture(scope="module")
def cycle() -> WindingResult:
    """A start and one and a half guide cycles."""
    return wind(winding_scene(duration=0.22, mode="reference"))


def new_run(scene: WindingScene) -> Run:
    return Run(scene, math.ceil(1e-3 / (0.9 * time_step_limit(scene))))


def run_to(run: Run, time: float) -> Run:
    while run.time < time:
        assert run.sample() == GOING
    return run


def test_a_step_of_speed_adds_the_impedance_times_the_speed():
    scene = winding_scene(speed_rise=0.0)
    run = new_run(scene)
    dt = run.setup.machine.dt
    run.advance(round(0.10e-3 / dt))  # the wave from the bobbin has passed the span, that from the feed is yet to come
    run.advance(round(0.04e-3 / dt))
    surface = scene.speed * math.cos(scene.winding_angle) * (1 + scene.diameter / 2 / scene.bobbin_radius)
    step = run.state.sums[SPAN] - scene.tension
    assert step == pytest.approx(scene.impedance * surface, rel=0.02)


def test_mean_tension_of_the_span_is_the_end_tension(cycle: WindingResult):
    turned = cycle.guide_phase >= cycle.guide_phase[-1] - 1
    assert cycle.outcome is WindingOutcome.COMPLETED
    assert cycle.span_tension[turned].mean() == pytest.approx(0.5, rel=0.02)


def test_the_yarn_presses_on_the_bobbin_as_a_ring(cycle: WindingResult):
    scene, last = cycle.scene, cycle.snapshots[-1]
    radius = np.hypot(last.position[:, 0], last.position[:, 1])
    force = scene.transverse_stiffness * scene.element_length * (scene.bobbin_radius + scene.diameter / 2 - radius)
    pull = last.tension - scene.linear_density * scene.speed**2  # the rest turns the yarn's own momentum
    ring = pull * scene.element_length * math.cos(scene.winding_angle) ** 2 / radius
    slope = np.gradient(last.position[:, 2], scene.element_length)
    helix = (abs(abs(slope) - math.sin(scene.winding_angle)) < 0.01) & (force > 0) & (np.arange(len(slope)) > 150)
    # The median, because a node below a crossing also bears the yarn above it.
    assert np.count_nonzero(helix) > 100
    assert np.median(force[helix] / ring[helix]) == pytest.approx(1, rel=0.03)


def test_energy_is_accounted_for(cycle: WindingResult):
    assert cycle.energy is not None
    assert cycle.energy.residual < 1e-3


def test_yarn_hardly_sinks_into_what_is_stiff(cycle: WindingResult):
    assert cycle.penetration_max < 0.1 * cycle.scene.diameter


def test_fast_and_reference_mode_agree_over_the_guide_cycle(cycle: WindingResult):
    fast = wind(replace(cycle.scene, mode="fast"))
    steady = cycle.time > 0.06
    assert np.corrcoef(fast.span_tension[steady], cycle.span_tension[steady])[0, 1] > 0.85
    np.testing.assert_allclose(fast.guide_position, cycle.guide_position, atol=1e-4)
    assert fast.layers_T_over_T0 == pytest.approx(cycle.layers_T_over_T0, abs=0.05)


def slow_guide(**changes: float) -> Run:
    """A guide nearly at rest beside the line of the yarn, which is drawn through it at full speed."""
    turned = winding_scene(
        duration=0.1, winding_angle=math.radians(0.5), turns_per_cycle=60.0, speed_rise=0.01, **changes
    )
    return run_to(new_run(turned), 0.02)


def tensions_at_guide(run: Run, samples: int) -> tuple[float, float, float]:
    """Mean tensions before and after the guide [N] and wrap [rad], over `samples` ms, every 20th step."""
    before, after, wraps = [], [], []
    rod = run.state.rod
    for _ in range(samples * run.steps_per_sample // 20):
        assert run.advance(20) == GOING
        j = int(run.state.counts[AT_GUIDE])
        upstream, downstream = slice(j + 5, j + 15), slice(j - 14, j - 4)
        before.append(rod.tension[upstream].mean())
        after.append(rod.tension[downstream].mean())
        directions = np.array([[t[s].mean() for t in (rod.tx, rod.ty, rod.tz)] for s in (upstream, downstream)])
        directions /= np.linalg.norm(directions, axis=1)[:, np.newaxis]
        wraps.append(math.acos(directions[0] @ directions[1]))
    return float(np.mean(before)), float(np.mean(after)), float(np.mean(wraps))


def test_a_guide_at_rest_without_friction_leaves_the_tension():
    before, after, wrap = tensions_at_guide(slow_guide(feed_length=0.1), 20)
    assert wrap > 0.15
    assert abs(after - before) < 0.005 * 0.5


def test_a_moving_guide_without_friction_leaves_the_tension():
    run = run_to(new_run(winding_scene(duration=0.2)), 0.08)
    before, after, wrap = tensions_at_guide(run, 30)
    assert wrap > 0.15
    assert abs(after - before) < 0.005 * 0.5


def test_a_guide_with_friction_is_a_capstan():
    before, after, wrap = tensions_at_guide(slow_guide(feed_length=0.1, guide_friction=0.5), 20)
    assert after / before == pytest.approx(math.exp(0.5 * wrap), rel=0.02)
    assert math.log(after / before) == pytest.approx(0.5 * wrap, rel=0.1)


def test_no_laid_yarn_is_in_the_mean_of_the_span():
    run = run_to(new_run(winding_scene(duration=0.2)), 0.1)
    s = run.state
    probe = slice(s.counts[LAID] + PROBE_MARGIN, s.counts[AT_GUIDE] - PROBE_MARGIN + 1)
    assert s.counts[LAID] > 200
    assert not np.any(s.grip.held[probe])
    assert np.all(s.rod.x[probe] < 0)
    touching = s.pairs.first[: s.counts[PAIRS]][s.pairs.slides[: s.counts[PAIRS]] > 0]
    assert not np.any(touching >= probe.start)


def test_the_limit_of_the_time_step_is_sharp():
    scene = winding_scene(duration=0.1, speed_rise=0.01)  # laid yarn, held by its grips, has the highest frequency
    limit = time_step_limit(scene)
    below, above = (Run(scene, round(1e-3 / (factor * limit))) for factor in (0.95, 1.05))
    run_to(below, 0.04)
    assert below.span[-1] == pytest.approx(0.5, rel=0.1)
    codes = [above.sample() for _ in range(40)]
    assert any(code != GOING for code in codes) or abs(above.span[-1]) > 5.0


def test_a_time_step_above_the_limit_is_refused_with_the_limit():
    scene = winding_scene(mode="reference", time_step=2e-6)
    result = wind(scene)
    assert result.outcome is WindingOutcome.TIME_STEP
    assert f"{time_step_limit(scene):.4g} s" in result.message
    assert math.isnan(result.penetration_max)


class Memory:
    """A checkpoint in memory."""

    def __init__(self) -> None:
        self.kept: Kept | None = None

    def load(self) -> Kept | None:
        return self.kept

    def save(self, kept: Kept) -> None:
        self.kept = kept


def test_a_run_is_the_same_bit_by_bit_also_from_a_checkpoint():
    scene = winding_scene(duration=0.03, mode="reference")
    whole, again = wind(scene), wind(scene)
    run = new_run(scene)
    for _ in range(13):
        run.sample()
    memory = Memory()
    memory.save(run.save())
    resumed = wind(scene, checkpoint=memory)
    for other in (again, resumed):
        np.testing.assert_array_equal(other.span_tension, whole.span_tension)
        np.testing.assert_array_equal(other.snapshots[-1].position, whole.snapshots[-1].position)
        assert other.energy is not None
        np.testing.assert_array_equal(other.energy.strain, whole.energy.strain)  # pyright: ignore[reportOptionalMemberAccess]


def test_a_checkpoint_of_another_scene_is_refused():
    run = new_run(winding_scene())
    memory = Memory()
    memory.save(run.save())
    with pytest.raises(ValueError, match="another scene"):
        wind(winding_scene(duration=0.5, mode="reference"), checkpoint=memory)
    assert memory.kept is not None
    del memory.kept["Pairs.gap"]
    with pytest.raises(ValueError, match="another version"):
        wind(winding_scene(mode="reference"), checkpoint=memory)


def test_a_free_tail_winds_and_ends_when_it_is_spent():
    tail = winding_scene(feed="tail", feed_length=0.3, speed_rise=0.02, duration=0.1, mode="reference")
    result = wind(tail)
    assert result.outcome is WindingOutcome.TAIL_SPENT
    assert 0.04 < result.time[-1] < 0.08
    assert result.span_tension[:30].mean() == pytest.approx(0.5, rel=0.1)
