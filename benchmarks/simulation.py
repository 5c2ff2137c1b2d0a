"""Physics: how closely the base follows its commands, how slip grows as friction falls, and how fast it all runs.

Run: python benchmarks/simulation.py. Bars: 3 % on the good floor; 8 times real time with all sensors on one core.
Times are of the process, and the best of some repeats, for other work on the machine slows each of them.
"""

import time

import numpy as np

from longreach.control.hardware import Command
from longreach.io.robots import load_robot
from longreach.sim.kinematic_config import KinematicConfig
from longreach.sim.kinematic_robot import KinematicRobot
from longreach.sim.monte_carlo import drive_many
from longreach.sim.physics import Simulation
from longreach.sim.record import make_recording
from longreach.sim.simulated import Simulated
from longreach.sim.worlds import FLOORS

COMMANDS = {"forward": (0.8, 0.0, 0.0), "sideways": (0.0, 0.8, 0.0), "turning": (0.0, 0.0, 1.0)}
HARDEST = (0.0, 1.0, 0.0)  # to and fro, with the base's full acceleration


def drive(simulation: Simulated, twist: np.ndarray, duration: float, tick: float) -> None:
    for _ in range(round(duration / tick)):
        simulation.write(Command(simulation.stamp, base=twist, arm=np.zeros(6)))
        simulation.advance(tick)
        simulation.read()


def shortfall(twist: tuple[float, float, float], floor: str) -> float:
    """Part of a steady command that the base lacks."""
    simulation = Simulation(load_robot("thing"), "laboratory", floor=floor)
    told = np.array(twist)
    drive(simulation, told, 2.5, 0.02)
    real = np.mean([t.twist for t in simulation.truths() if t.stamp > 1.2], axis=0)
    return float(np.linalg.norm(real - told) / np.linalg.norm(told))


def slip(floor: str) -> float:
    """Part of the way that its wheels roll which the base does not go, when it is driven hard to and fro."""
    thing = load_robot("thing")
    simulation = Simulation(thing, "laboratory", floor=floor)
    wheels = []
    for i in range(100):
        twist = np.array(HARDEST) * (1 if i // 25 % 2 == 0 else -1)
        simulation.write(Command(simulation.stamp, base=twist))
        simulation.advance(0.02)
        wheels += [w.ticks for w in simulation.read().wheels]
    assert thing.description.base is not None
    rolled = np.diff(wheels, axis=0) @ thing.description.base.forward_matrix.T
    gone = np.diff([t.base for t in simulation.truths()[::2]], axis=0)[: len(rolled)]
    return float(np.abs(rolled - gone)[:, 1].sum() / np.abs(rolled)[:, 1].sum())


def speed(tick: float, windows: int = 20, seconds: float = 1.0) -> tuple[float, float]:
    """How many times faster than real time, on one core: the median and the best of some windows."""
    simulation = Simulation(load_robot("thing"), "laboratory")
    drive(simulation, np.zeros(3), 0.2, tick)  # kernels are loaded
    found = []
    for i in range(windows):
        began = time.process_time()
        drive(simulation, np.array([0.4, 0.3, 0.5]) * (1 if i % 2 == 0 else -1), seconds, tick)
        found.append(seconds / (time.process_time() - began))
    return float(np.median(found)), max(found)


def kinematic_speed(present: tuple[str, ...], tick: float, seconds: float = 5.0) -> float:
    """How many times faster than real time the robot without forces is, at best."""
    simulation = KinematicRobot(load_robot("thing"), config=KinematicConfig.model_validate({"present": present}))
    found = []
    for _ in range(10):
        began = time.process_time()
        drive(simulation, np.array([0.1, 0.1, 0.1]), seconds, tick)
        found.append(seconds / (time.process_time() - began))
    return max(found)


def many_speed(runs: int = 100, ticks: int = 500) -> float:
    """How many times faster than real time drives by the thousand are, at best."""
    thing, twists = load_robot("thing"), np.random.default_rng(0).uniform(-1.0, 1.0, (runs, ticks, 3))
    drive_many(thing, twists[:1])
    found = []
    for _ in range(5):
        began = time.process_time()
        drive_many(thing, twists)
        found.append(0.02 * runs * ticks / (time.process_time() - began))
    return max(found)


def scan_time() -> float:
    """Milliseconds a sweep of 1081 beams takes, noise included."""
    thing = load_robot("thing")
    simulation = Simulation(thing, "laboratory")
    scanner, rng, bases = simulation._scanner, np.random.default_rng(0), np.zeros((64, 3))
    assert scanner is not None
    scanner.read(0.0, 0.0, 1e-3, bases, rng)
    took = []
    for _ in range(200):
        began = time.perf_counter()
        scanner.read(0.0, 0.0, 1e-3, bases, rng)
        took.append(time.perf_counter() - began)
    return 1e3 * float(np.median(took))


def main() -> None:
    for name, twist in COMMANDS.items():
        print(f"{name:9s} {100 * shortfall(twist, 'good'):.2f} % off the command on the good floor (bar 3 %)")
    slips = {floor: slip(floor) for floor in FLOORS}
    print("slip, driven hard:", ", ".join(f"{f} (μ {FLOORS[f]:g}) {100 * s:.0f} %" for f, s in slips.items()))
    for tick, who in ((0.02, "base commands at 50 Hz"), (0.008, "arm and base at 125 Hz")):
        median, best = speed(tick)
        print(f"speed, all sensors, {who}: {median:.1f} times real time, best second {best:.1f} (bar 8)")
    for tick, present in ((0.008, ("wheels", "imu", "joints")), (0.02, ("wheels",))):
        times = kinematic_speed(present, tick)
        print(f"kinematic, {', '.join(present)}, commands at {1 / tick:.0f} Hz: {times:.0f} times real time")
    print(f"kinematic, many drives at once: {many_speed():.0f} times real time")
    began = time.process_time()
    make_recording(load_robot("thing"), duration=20.0)
    print(f"a recording of 20 s through the laboratory: {20.0 / (time.process_time() - began):.1f} times real time")
    print(f"a sweep of 1081 beams: {scan_time():.3f} ms (bar 0.5)")


if __name__ == "__main__":
    main()
