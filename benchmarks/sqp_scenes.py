"""Random scenes with obstacles across the path: passed without touching, between the waypoints too, in what time.

    OMP_NUM_THREADS=1 python benchmarks/sqp_scenes.py --bench FOLDER [--scenes 50] [--arm-scenes 12] [--ipopt-scenes 10]

FOLDER holds dual.npz, see `sqp.py`, every second waypoint of which is taken. The base may go 0.3 m aside and turn by
0.5 rad. Obstacles for the base stand 2 to 20 cm in its way; those for the arm are such that a detour is known. Scenes
beside IPOPT (where casadi is installed) are those of round obstacles, with -log M. Times are of the processor.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from sqp import HOME, THING, plan, start_of
from sqp_casadi import BASE, STEP, casadi_trajectory

import longreach as lr
from longreach.planning.obstacles import Box, Capsule, Disc, Obstacle, link_capsules
from longreach.planning.terms_clearance import (
    Keeping,
    SelfClearance,
    arm_clearance,
    base_clearance,
    least_clearance,
)


def scene(rng: np.random.Generator, base: np.ndarray) -> tuple[Obstacle, ...]:
    """Return one to three obstacles on one side of the base's path, 2 to 20 cm too near."""
    out: list[Obstacle] = []
    side = rng.choice([-1.0, 1.0])
    for _ in range(rng.integers(1, 4)):
        k = int(rng.integers(len(base) // 8, 7 * len(base) // 8))
        along = base[k + 1, :2] - base[k - 1, :2]
        normal = side * np.array([-along[1], along[0]]) / np.linalg.norm(along)
        radius = rng.uniform(0.05, 0.3)
        middle = base[k, :2] + normal * (BASE + radius - rng.uniform(0.02, 0.2))
        kind, turn = rng.integers(3), rng.uniform(0.0, np.pi)
        if kind == 0:
            out.append(Disc(middle, radius))
        elif kind == 1:
            T = np.eye(4)
            T[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
            T[:3, 3] = [*middle, 0.4]
            out.append(Box(T, np.array([1.4 * radius, 1.4 * radius, 0.8])))
        else:
            out.append(Capsule(np.append(middle, 0.0), np.append(middle, 1.0), radius))
    return tuple(out)


def base_scene(rng: np.random.Generator, ref: lr.Reference, _: np.ndarray) -> tuple[Keeping, ...]:
    """Return what keeps the base clear of a random scene."""
    assert ref.base is not None
    return (base_clearance(BASE, scene(rng, ref.base)),)


def detour(rng: np.random.Generator, ref: lr.Reference) -> np.ndarray:
    """Return configurations (N, 9) on the tool's path whose base goes aside and turns for a while."""
    assert ref.base is not None
    s = np.linspace(0.0, 1.0, len(ref))
    hump = np.exp(-(((s - rng.uniform(0.35, 0.65)) / 0.2) ** 2))
    angle, aside = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.1, 0.28)
    turn = rng.uniform(0.15, 0.45) * rng.choice([-1.0, 1.0])
    by = np.array([aside * np.cos(angle), aside * np.sin(angle), turn])
    return start_of(lr.Reference(ref.stamps, ref.tool, ref.base + hump[:, None] * by))


def arm_scene(rng: np.random.Generator, ref: lr.Reference, q: np.ndarray) -> tuple[Keeping, ...]:
    """Return what keeps the arm clear of one or two balls and beams across its way along q, and of its base.

    A detour of the base leads past all of them by 5 mm at least, so that there is an answer.
    """
    elbows = THING.chain.ending("forearm_link").forward_and_jacobian_batch(q)[0][:, :3, 3]
    most = 0.9 * max(STEP, 1.5 * np.abs(np.diff(q, axis=0)).max())
    out: list[Obstacle] = []
    other = q
    while not out:
        other = detour(rng, ref)
        if np.abs(np.diff(other, axis=0)).max() > most or np.abs(THING.forward(other) - ref.tool).max() > 1e-6:
            continue
        for _ in range(40):
            away = rng.standard_normal(3)
            middle = elbows[rng.integers(len(q) // 8, 7 * len(q) // 8)]
            middle = middle + away / np.linalg.norm(away) * (0.24 - rng.uniform(0.01, 0.06))
            half = rng.choice([0.0, 0.2]) * np.array([1.0, 0.0, 0.0])
            obstacle = Capsule(middle - half, middle + half, 0.1)
            term = arm_clearance(THING, (obstacle,))
            across, past = (least_clearance(THING, x, term)[0] for x in (q, other))
            if len(out) < 2 and across < -0.01 and past > 0.005:
                out.append(obstacle)
    far = tuple(c for c in link_capsules(THING) if c.frame not in ("shoulder_link", "upper_arm_link"))
    T_base_body = np.eye(4)
    T_base_body[2, 3] = 0.168
    own = SelfClearance(far, (Box(T_base_body, np.array([0.96, 0.793, 0.296])),))
    here, there = (least_clearance(THING, x, own)[0] for x in (q, other))
    return arm_clearance(THING, tuple(out)), replace(own, margin=max(min(there - 0.005, here + 0.03), 0.0))


def scenes(name: str, make: Callable[..., tuple[Keeping, ...]], ref: lr.Reference, count: int) -> None:
    """Print how many random scenes are passed without touching, between the waypoints too."""
    passed, solved, times, least, q0 = 0, 0, [], np.inf, start_of(ref)
    for seed in range(count):
        terms = make(np.random.default_rng(seed), ref, q0)
        began = time.process_time()
        trajectory = plan(ref, problem=lr.thesis_problem(0.3, 0.5).adding(*terms))
        times.append(time.process_time() - began)
        clear = min(least_clearance(THING, trajectory.q, term, finer=50)[0] - term.margin for term in terms)
        good = not trajectory.solution.violated and clear >= 0.0
        passed, solved = passed + good, solved + trajectory.solution.converged
        least = min(least, clear) if good else least
    print(
        f"{count} scenes for the {name}, {len(ref)} waypoints: {passed} without touching, {solved} solved to 5e-7, "
        f"median {np.median(times):.2f} s CPU, longest {np.max(times):.2f} s, least clearance {1e3 * least:.3f} mm"
    )


def scenes_beside_ipopt(ref: lr.Reference, count: int) -> None:
    """Print the same for scenes of round obstacles and -log M, beside IPOPT from the same start."""
    assert ref.base is not None
    q0 = start_of(ref)
    steps = np.diff(q0, axis=0)
    weight, step = 6.6e-4 / float(np.sum(steps**2, axis=1).mean()), max(STEP, 1.5 * np.abs(steps).max())
    times, passed, seed = np.zeros((2, count)), np.zeros((2, 2), dtype=int), 0
    for i in range(count):
        while any(isinstance(o, Box) for o in scene(np.random.default_rng(seed), ref.base)):
            seed += 1
        obstacles = scene(np.random.default_rng(seed), ref.base)
        seed += 1
        term = base_clearance(BASE, obstacles)
        began = time.process_time()
        ours = plan(ref, problem=lr.thesis_problem(0.3, 0.5, objective="neg_log_m").adding(term)).q
        times[0, i] = time.process_time() - began
        theirs, times[1, i] = casadi_trajectory(ref, q0, "ipopt", weight, (0.3, 0.5, step), obstacles)
        for j, q in enumerate((ours, theirs)):
            held = np.abs(THING.forward(q) - ref.tool).max() <= 1e-6
            for finer, least in ((1, -1e-6), (50, 0.0)):
                passed[j, int(finer > 1)] += held and least_clearance(THING, q, term, finer=finer)[0] >= least
    for name, number, row in zip(("longreach", "casadi ipopt"), passed, times, strict=True):
        print(
            f"{count} scenes of round obstacles, {name}: {number[0]} without touching at waypoints, "
            f"{number[1]} between them too, median {np.median(row):.2f} s"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bench", type=Path, required=True)
    parser.add_argument("--scenes", type=int, default=50)
    parser.add_argument("--arm-scenes", type=int, default=12)
    parser.add_argument("--ipopt-scenes", type=int, default=10)
    options = parser.parse_args()
    dual = np.load(options.bench / "dual.npz")
    HOME[:] = dual["home"]
    ref = lr.Reference(0.2 * np.arange(len(dual["T"][::2])), dual["T"][::2], dual["B"][::2])
    for name, make, count in (("base", base_scene, options.scenes), ("arm", arm_scene, options.arm_scenes)):
        if count:
            scenes(name, make, ref, count)
    if find_spec("casadi") and options.ipopt_scenes:
        scenes_beside_ipopt(ref, options.ipopt_scenes)


if __name__ == "__main__":
    main()
