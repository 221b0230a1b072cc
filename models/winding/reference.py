"""Reference mode: explicit dynamics of the yarn from the feed to the package, which stays live to its first node.

The time step itself is in `stepping.py`, elements in `rod.py`, contacts in `contact.py`.
"""

import math
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.winding.contact import Bobbin, Crossing, new_grip, new_pairs
from models.winding.drive import travel, traverses
from models.winding.result import (
    Checkpoint,
    EnergyLedger,
    Kept,
    Progress,
    Snapshot,
    WindingOutcome,
    WindingResult,
    giving_said,
)
from models.winding.rod import Material, new_rod
from models.winding.sampling import SAMPLE_INTERVAL, SHOWN_LAYERS, layer_means, sample_times
from models.winding.scene import WindingScene
from models.winding.stepping import (
    AT_EYELET,
    AT_GUIDE,
    BULK_VISCOSITY,
    DEEPEST,
    DIVERGED,
    DRIFT,
    FEED_RUN,
    FULL,
    GOING,
    LAID,
    NODES,
    SPAN,
    SPENT,
    STEP,
    WORK,
    Machine,
    Setup,
    State,
    advance,
    grip_stiffness,
    time_step_limit,
)

Array = NDArray[np.float64]

SAFETY = 0.9
"""Share of the limit of stability that is used."""
CHECKPOINT_INTERVAL = 20.0
"""[s] of computation."""
SNAPSHOT = ("time", "layer", "position", "tension")
"""Fields of a snapshot in a checkpoint."""
OUTCOMES = {
    GOING: WindingOutcome.COMPLETED,
    DIVERGED: WindingOutcome.DIVERGED,
    SPENT: WindingOutcome.TAIL_SPENT,
}


class Run:
    """The state of a reference run."""

    def __init__(self, scene: WindingScene, steps_per_sample: int) -> None:
        self.scene = scene
        self.steps_per_sample = steps_per_sample
        natural, diameter = scene.element_length, scene.diameter
        mass = scene.linear_density * natural
        taper = math.tan(scene.cone_angle)
        surface = scene.transverse_stiffness * natural
        grip = grip_stiffness(scene)
        active = scene.feed == "active"
        top = scene.bobbin_radius + diameter / 2 / math.cos(scene.cone_angle) - taper * scene.stroke / 2
        material = Material(natural, scene.axial_stiffness, scene.bending_stiffness, BULK_VISCOSITY * scene.impedance)
        bobbin = Bobbin(
            radius=scene.bobbin_radius + diameter / 2 / math.cos(scene.cone_angle),
            taper=taper,
            stiffness=surface,
            damping=2 * scene.contact_damping * math.sqrt(surface * mass),
            grip=grip,
            grip_damping=2 * scene.contact_damping * math.sqrt(grip * mass),
        )
        crossing = Crossing(
            diameter=diameter,
            surface=scene.transverse_stiffness,
            element=natural,
            mass=mass,
            damping=scene.contact_damping,
            static=scene.friction_static,
            dynamic=scene.friction_dynamic,
        )
        machine = Machine(
            dt=SAMPLE_INTERVAL / steps_per_sample,
            mass=mass,
            speed=scene.speed,
            rise=scene.speed_rise,
            speed_slope=scene.speed_slope,
            pull=scene.tension,
            pull_slope=scene.tension_slope,
            turning=math.cos(scene.winding_angle) / scene.bobbin_radius,
            per_cycle=2 * math.pi * scene.turns_per_cycle,
            stroke=scene.stroke,
            reversal=scene.reversal,
            guide=-scene.guide_distance,
            eyelet=-scene.guide_distance - scene.feed_length,
            top=top,
            clearance=scene.guide_clearance,
            friction=scene.guide_friction,
            active=active,
            impedance=scene.impedance,
            memory=scene.feed_memory,
        )
        weights, times = np.array(scene.prony_weights), np.array(scene.prony_times)
        self.setup = Setup(material, bobbin, crossing, machine, weights, times)
        self._thread()

    def _thread(self) -> None:
        """Yarn at rest from the top of the bobbin through the guide to the feed, stretched by T₀."""
        scene, machine = self.scene, self.setup.machine
        spacing = scene.element_length * (1 + scene.tension / scene.axial_stiffness)
        start = -scene.stroke / 2
        corners_x = [0.0, machine.guide, machine.eyelet]
        corners_z = [start, start, 0.0 if machine.active else start]
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(corners_x), np.diff(corners_z)))])
        nodes = int(arc[-1] / spacing) + (FEED_RUN if machine.active else 1)
        room = nodes + (int(1.03 * scene.wound_length / scene.element_length) + 100 if machine.active else 0)
        places = spacing * np.arange(nodes)
        rod, grip, counts = new_rod(room, len(scene.prony_weights)), new_grip(room), np.zeros(7, np.int64)
        rod.x[:nodes] = np.interp(places, arc, corners_x) - np.maximum(places - arc[-1], 0.0)
        rod.y[:nodes] = machine.top
        rod.z[:nodes] = np.interp(places, arc, corners_z)
        grip.held[0], grip.y[0], grip.z[0] = 1, machine.top, start
        counts[[NODES, AT_GUIDE, AT_EYELET, LAID]] = nodes, 1, 1, 1
        pairs = 4 * room + 1000
        self.state = State(
            rod, grip, new_pairs(pairs), new_pairs(pairs), np.zeros(room), counts, np.zeros(10), np.zeros(4)
        )
        self.span: list[float] = []
        self.ledger = [np.concatenate([[0.0], self._start_energies(nodes), np.zeros(7)])]
        self.snapshots: list[Snapshot] = []

    def _start_energies(self, nodes: int) -> Array:
        """Kinetic, strain, bending and contact energy [J] before the first step."""
        m, rod = self.setup.material, self.state.rod
        edge = np.diff(np.stack([rod.x[:nodes], rod.y[:nodes], rod.z[:nodes]]))
        length = np.linalg.norm(edge, axis=0)
        turn = np.diff(edge / length)
        strain = m.axial * m.natural / 2 * np.sum((length / m.natural - 1) ** 2)
        return np.array([0.0, strain, m.bending / m.natural / 2 * np.sum(turn**2), 0.0])

    def advance(self, steps: int) -> int:
        """Take `steps` steps; GOING or why it stopped."""
        return advance(self.state, self.setup, steps)

    @property
    def time(self) -> float:
        """[s]."""
        return float(self.state.counts[STEP]) * self.setup.machine.dt

    def phase(self, time: float) -> float:
        """Guide cycles since the start."""
        m = self.setup.machine
        return travel(time, m.speed, m.rise, m.speed_slope)[0] * m.turning / m.per_cycle

    def snapshot(self) -> Snapshot:
        """The laid yarn now, in the bobbin's frame."""
        rod, laid = self.state.rod, int(self.state.counts[LAID])
        laid = laid if laid > 1 else 0  # one node is no yarn yet
        angle = self.phase(self.time) * self.setup.machine.per_cycle
        x, y = rod.x[:laid], rod.y[:laid]
        before = rod.tension[: max(laid - 1, 0)]
        return Snapshot(
            time=self.time,
            layer=np.floor(self.state.landed[:laid]).astype(np.int64) + 1,
            position=np.column_stack(
                [
                    math.cos(angle) * x - math.sin(angle) * y,
                    math.sin(angle) * x + math.cos(angle) * y,
                    rod.z[:laid],
                ]
            ),
            tension=np.concatenate([before[:1], (before[1:] + before[:-1]) / 2, before[-1:]]),
        )

    def sample(self) -> int:
        """Advance by one sample; GOING or why it stopped."""
        code = self.advance(self.steps_per_sample)
        sums, energies = self.state.sums, self.state.energies
        if code == GOING and not (math.isfinite(sums[SPAN]) and np.all(np.isfinite(energies))):
            return DIVERGED
        if code == GOING:
            self.span.append(float(sums[SPAN]))
            self.ledger.append(np.concatenate([[self.time], energies, sums[:DRIFT]]))
            done = self.phase(self.time)
            if any(self.phase(self.time - SAMPLE_INTERVAL) < layer <= done for layer in SHOWN_LAYERS):
                self.snapshots.append(self.snapshot())
        return code

    def _arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays of the state, by name."""
        s = self.state
        arrays: dict[str, NDArray[Any]] = {
            "landed": s.landed,
            "counts": s.counts,
            "sums": s.sums,
            "energies": s.energies,
        }
        for group in (s.rod, s.grip, s.pairs):
            arrays |= {f"{type(group).__name__}.{name}": array for name, array in group._asdict().items()}
        return arrays

    def save(self) -> Kept:
        """Everything that `load` needs to go on, bit by bit, as if the run had not stopped."""
        kept = {name: array.copy() for name, array in self._arrays().items()}
        kept |= {"span": np.array(self.span), "ledger": np.array(self.ledger)}
        for k, shot in enumerate(self.snapshots):
            kept |= {f"snapshot{k}.{name}": np.asarray(getattr(shot, name)) for name in SNAPSHOT}
        return kept

    def load(self, kept: Kept) -> None:
        """Go on from `kept`.

        Raises
        ------
        ValueError
            If it belongs to another scene, as far as its array sizes and its time show, or to another version of this.
        """
        arrays = self._arrays()
        if not arrays.keys() <= kept.keys():
            raise ValueError("checkpoint: of another version of this program; remove it to start anew")
        steps = self.steps_per_sample * len(kept["span"])
        if kept["Rod.x"].shape != self.state.rod.x.shape or int(kept["counts"][STEP]) != steps:
            raise ValueError("checkpoint: belongs to another scene or time step; remove it to start anew")
        for name, array in arrays.items():
            array[...] = kept[name]
        self.span = [float(x) for x in kept["span"]]
        self.ledger = list(kept["ledger"])
        self.snapshots = []
        while f"snapshot{len(self.snapshots)}.time" in kept:
            time, layer, position, tension = (kept[f"snapshot{len(self.snapshots)}.{name}"] for name in SNAPSHOT)
            self.snapshots.append(Snapshot(float(time), layer, position, tension))


def wind_reference(
    scene: WindingScene, reason: str, progress: Progress | None = None, checkpoint: Checkpoint | None = None
) -> WindingResult:
    """Run `scene` in the reference mode; see `wind`.

    Parameters
    ----------
    reason : why this mode, kept in the result.
    """
    limit = time_step_limit(scene)
    step = SAFETY * limit if scene.time_step is None else scene.time_step
    if step > limit:
        outcome = WindingOutcome.TIME_STEP
        message = f"time_step = {step:.4g} s: {outcome.value}; the limit of this scene is {limit:.4g} s"
        return WindingResult(scene, "reference", reason, outcome, message, time_step=step, time_step_limit=limit)
    run = Run(scene, math.ceil(SAMPLE_INTERVAL / step))
    run.advance(0)  # compiles, outside the time taken
    begin = perf_counter()
    state = checkpoint.load() if checkpoint is not None else None
    if state is not None:
        run.load(state)
    ends = sample_times(scene)
    code, kept = GOING, perf_counter()
    # A step of a node costs the same wherever it is, and nodes grow with the yarn laid: the work done rises with both.
    start, full = float(run.state.counts[NODES]), len(ends)
    rise = scene.wound_length / scene.element_length / full if scene.feed == "active" else 0.0
    while len(run.span) < full and code == GOING:
        code = run.sample()
        if progress is not None:
            k = len(run.span)
            progress(k * (start + rise * k / 2) / (full * (start + rise * full / 2)))
        if checkpoint is not None and perf_counter() - kept > CHECKPOINT_INTERVAL:
            checkpoint.save(run.save())
            kept = perf_counter()
    if code == FULL:
        raise RuntimeError("the arrays of the run were sized too small for its nodes or pairs")
    if checkpoint is not None and code == GOING:
        checkpoint.save(run.save())
    outcome = OUTCOMES[code]
    m, bobbin = run.setup.machine, run.setup.bobbin
    done = ends[: len(run.span)]
    phase = np.array([run.phase(t) for t in done])
    end = run.snapshot()
    pull = scene.tension + scene.tension_slope * end.time
    ledger = EnergyLedger(*np.array(run.ledger).T)
    depth = bobbin.radius + bobbin.taper * end.position[:, 2] - np.hypot(*end.position[:, :2].T)
    deepest = float(depth.max(initial=run.state.sums[DEEPEST]))
    return WindingResult(
        scene=scene,
        mode="reference",
        mode_reason=reason,
        outcome=outcome,
        message=giving_said(scene, deepest) if outcome.ok else f"{outcome.value} (at t = {run.time:.4g} s)",
        time=done,
        span_tension=np.array(run.span),
        guide_phase=phase,
        guide_position=m.stroke * traverses(phase, m.reversal),
        layers_T_over_T0=layer_means(end.layer, end.tension / pull, math.floor(run.phase(run.time))),
        snapshots=(*run.snapshots, end),
        energy=ledger,
        penetration_max=deepest,
        time_step=m.dt,
        time_step_limit=limit,
        element_steps=int(run.state.counts[WORK]),
        wall_s=perf_counter() - begin,
    )
