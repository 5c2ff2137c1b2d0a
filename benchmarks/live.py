"""A robot served and watched over loopback: what is lost, how long messages are under way, what it costs.

    python benchmarks/live.py --minutes 10              losses, delays, the server's CPU and memory
    python benchmarks/live.py --page                    how long STOP takes from a page that shows a robot that drives
    python benchmarks/live.py --dual-trajectory         the tool's error through the network beside that in one process

The server is `longreach serve` with a simulated Thing, physics and scans, in a process of its own, as are the clients
that only watch.
"""

import argparse
import atexit
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import longreach as lr
from longreach.app import robot_side
from longreach.app.dual_trajectory import DualTrajectoryConfig, planned
from longreach.app.execution import execute
from longreach.app.goals import Follow
from longreach.app.operated import simulated
from longreach.app.robot_side import Orders
from longreach.errors import LongreachError
from longreach.evaluation.execution import tool_metrics
from longreach.live.realtime_settings import apply_realtime_settings
from longreach.live.server.serving import tracker_config

_WATCH = "import sys, time, longreach as lr\nclient = lr.connect(sys.argv[1])\nprint(flush=True)\ntime.sleep(1e6)"
# How late a process that only sleeps is woken, p50 and p99 [ms]: below that no message can be received either.
_SLEEP = """
import sys, time, threading
late, ended = [], []
threading.Thread(target=lambda: ended.append(sys.stdin.read()), daemon=True).start()
while not ended:
    began = time.perf_counter()
    time.sleep(0.02)
    late.append(1e3 * (time.perf_counter() - began) - 20.0)
late.sort()
print(late[len(late) // 2], late[int(0.99 * len(late))])
"""
_ADDRESS = f"127.0.0.1:{20000 + os.getpid() % 20000}"
_TICKS = os.sysconf("SC_CLK_TCK")


class Server:
    """`longreach serve` in a process of its own."""

    def __init__(self, hardware, *options):
        command = [sys.executable, "-m", "longreach", "serve", "--hardware", hardware, "--address", _ADDRESS, *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        atexit.register(self.process.kill)

    def ready(self):
        while "Serving" not in self.process.stdout.readline():
            assert self.process.poll() is None
        return self

    def cpu(self):
        """What it has computed so far [s]."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / _TICKS

    def memory(self):
        """What it holds [MB]."""
        return int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6

    def end(self):
        self.process.terminate()
        print(self.process.stdout.read().strip())
        self.process.wait()


def cpu_of(server, seconds):
    """The server's CPU over a while, part of one core."""
    cpu, began = server.cpu(), time.monotonic()
    time.sleep(seconds)
    return (server.cpu() - cpu) / (time.monotonic() - began)


def watchers(count):
    """Clients that only watch, each a process."""
    started = [
        subprocess.Popen([sys.executable, "-c", _WATCH, _ADDRESS], stdout=subprocess.PIPE, text=True)
        for _ in range(count)
    ]
    for one in started:
        one.stdout.readline()
    return started


def costs(server, seconds):
    """The server's CPU with nobody, one and five who watch, as rows of the report."""
    rows = []
    for count in (0, 1, 5):
        clients = watchers(count)
        time.sleep(1.0)
        rows.append((f"server's CPU, {count} watching", f"{100 * cpu_of(server, seconds):.0f} % of a core", ""))
        for one in clients:
            one.kill()
            one.wait()
    return rows


def ways(server, minutes):
    """Losses and delays of one client, and the server's memory, over a time, as rows of the report."""
    apply_realtime_settings()
    with lr.connect(_ADDRESS) as client:
        time.sleep(2.0)
        stamps, scans, memory, offsets = [], [], [], []
        client._subscriber.delays.clear()
        lost, delays = client.lost, []
        client.on_state(lambda state: stamps.append(state.stamp))
        client.on_scan(lambda scan: scans.append(scan.stamp))
        sleeper = subprocess.Popen(
            [sys.executable, "-c", _SLEEP], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        began, cpu = time.monotonic(), server.cpu()
        while time.monotonic() - began < 60.0 * minutes:
            time.sleep(2.0)
            delays.append(np.array(client._subscriber.delays, dtype=np.float32))
            client._subscriber.delays.clear()
            memory.append((time.monotonic() - began, server.memory()))
            offsets.append(client.offset)
        delays, memory = 1e3 * np.concatenate(delays), np.array(memory)
        wall, cpu = time.monotonic() - began, server.cpu() - cpu
        gaps = [np.diff(np.array(s)) for s in (stamps, scans)]
        missing = [int(np.sum(np.round(gap / period) - 1)) for gap, period in zip(gaps, (0.008, 0.025), strict=True)]
        p50, p99, p100 = np.percentile(delays, [50, 99, 100])
        slope, error = slope_of(memory[memory[:, 0] > min(60.0, 30.0 * minutes)])
        late = [float(word) for word in sleeper.communicate("over")[0].split()]
        half = 0.5e3 * min(client._connection._pings)[0]
        stops = [stop_takes(client) for _ in range(20)]
    return [
        ("states, scans each second", f"{len(stamps) / wall:.1f}, {len(scans) / wall:.1f}", "125, 40"),
        ("states lost, scans lost", f"{missing[0]} of {len(stamps)}, {missing[1]} of {len(scans)}", "0"),
        ("messages lost, of any kind", f"{client.lost - lost} of {len(delays)}", "0"),
        ("under way, median", f"{p50:.2f} ms", "1 ms"),
        ("under way, 99th percentile", f"{p99:.2f} ms", "5 ms"),
        ("under way, longest", f"{p100:.1f} ms", ""),
        ("a process that only sleeps is woken", f"{late[0]:.2f} ms late, {late[1]:.2f} ms at the 99th percentile", ""),
        ("offset of the clocks", f"known to {half:.2f} ms; the simulation's moved by {np.ptp(offsets):.3f} s", ""),
        ("server's CPU, all the time", f"{100 * cpu / wall:.0f} % of a core", ""),
        ("server's memory", f"{memory[-1, 1]:.0f} MB, {slope:+.3f} ± {error:.3f} MB a minute", "flat"),
        ("from stop() to the gate", f"median {np.median(stops):.1f} ms, longest {max(stops):.1f} ms", "50 ms"),
    ]


def slope_of(memory):
    """The memory's slope [MB a minute] and its standard error, of means over a twentieth of the time each."""
    t, y = np.array([part.mean(axis=0) for part in np.array_split(memory, min(20, len(memory)))]).T
    t = t / 60.0 - t.mean() / 60.0
    slope = t @ y / (t @ t)
    rest = y - y.mean() - slope * t
    return slope, np.sqrt(rest @ rest / max(len(t) - 2, 1) / (t @ t))


def told(rows, minutes):
    """The report: a table in markdown."""
    head = [
        f"# A robot over loopback, {minutes:g} minutes\n",
        f"{os.cpu_count()} CPUs, load {os.getloadavg()[1]:.1f}.\n",
    ]
    table = [("what", "measured", "bar"), ("---", "---", "---"), *rows]
    return "\n".join([*head, *("| " + " | ".join(row) + " |" for row in table)]) + "\n"


def stop_takes(client):
    """From the call of stop to the tick that obeys, on the robot's clock [ms]."""
    seen = []
    ended = client.on_state(lambda state: seen.append(state.stamp) if state.stop else None)
    began = time.perf_counter()
    client.stop("for the benchmark")
    while not seen:
        time.sleep(0.0005)
    took = 1e3 * (time.perf_counter() - began)
    ended()
    client.reset()
    while client.state.stop:
        time.sleep(0.001)
    time.sleep(0.05)
    return took


def page_stops(count):
    """From the key in a browser to the tick that obeys, while base and arm move [ms] (count,).

    Both clocks are this machine's: the page's own, and the robot's by what the client knows of its offset.
    """
    from playwright.sync_api import sync_playwright

    command = [sys.executable, "-u", "-m", "longreach", "view", "--connect", _ADDRESS, "--port", "0"]
    view, took = subprocess.Popen(command, stdout=subprocess.PIPE, text=True), []
    atexit.register(view.kill)
    address = next(found.group() for line in view.stdout if (found := re.search(r"http://[\d.:]+/[\w-]+/", line)))
    with lr.connect(_ADDRESS) as client, sync_playwright() as started:
        browser = started.chromium.launch(
            executable_path="/usr/bin/chromium", args=["--no-sandbox", "--use-gl=swiftshader"]
        )
        page = browser.new_page()
        page.add_init_script("window.addEventListener('keydown', () => { window.pressed = Date.now() }, true)")
        page.goto(address)
        page.wait_for_function("document.getElementById('longreach-stop')")
        time.sleep(5.0)
        for _ in range(count):
            until = time.monotonic() + 0.8
            while time.monotonic() < until:
                client.velocity(np.full(client.robot.dof - 3, 0.05), np.array([0.1, 0.0, 0.3]))
                time.sleep(0.02)
            page.keyboard.press("Space")
            while not client.state.latched:
                time.sleep(0.002)
            pressed = page.evaluate("window.pressed")
            took.append(1e3 * (client.state.stopped_at - client.offset) - pressed)
            for _ in range(3):  # the page repeats what it has not seen obeyed yet
                time.sleep(1.0)
                with suppress(LongreachError):
                    client.reset()
        browser.close()
    view.kill()
    return np.array(took)


def dual_trajectory(length, seeds):
    """The tool's error of the experiment, driven through a server and in one process, RMS [mm], of some seeds.

    In one process the same simulation stands for as long as it stood on the server before the plan came. For comparison
    the experiment as `longreach run` does it, which begins at once: another stretch of the same noise.
    """
    config, thing, errors = DualTrajectoryConfig(length=length), lr.load_robot("thing"), []
    apply_realtime_settings()
    for seed in range(seeds):
        settings = config.execution(seed, "closed")
        server, states = Server("sim", "--world", settings.world, "--seed", str(seed)), []
        _, plan = planned(thing, config)
        server.ready()
        with lr.connect(_ADDRESS) as client:
            client.on_state(states.append)
            client.execute(plan)
        server.end()
        began = next(state.stamp for state in states if state.goal == "follow")
        at_once = tool_metrics(execute(thing, plan, settings).traces)["tool_error"]["value"]
        errors.append(
            1e3 * np.array([tool_error(thing, states), in_one_process(thing, plan, settings, began), at_once])
        )
        stopped = sum(bool(state.stop) for state in states)
        if stopped:
            print(f"the robot waited for its client for {stopped} ticks: compare on a machine with less to do")
        print("seed {}: {:.3f} mm through the network, {:.3f} in one process, {:.3f} at once".format(seed, *errors[-1]))
    through, alone, at_once = np.sqrt(np.mean(np.square(errors), axis=0))
    print(f"ratio {through / alone:.4f} (bar: within 10 %); to where it begins at once {through / at_once:.3f}")


def in_one_process(thing, plan, settings, began):
    """The tool's error [m] where the plan comes at the same time, and nothing goes over a network."""
    body, states = simulated("sim", thing, settings.world, settings.seed), []

    def take(now):
        return Orders(goal=Follow(plan, -0.3) if abs(now - began) < 1e-6 else None)

    def publish(moment):
        goal = type(moment.state.goal).__name__.lower()
        states.append(SimpleNamespace(goal=goal, reference=moment.tick.q_reference, tool_truth=body.truth().tool))

    def ended():
        return "over" if body.stamp > began + 0.1 and states[-1].goal == "hold" else ""

    robot_side.run(
        body, lambda stamp: body.advance(max(stamp - body.stamp, 0.0)), thing, body.truth().base, take, publish, ended,
        tracker_config(body, thing),
    )  # fmt: skip
    return tool_error(thing, states)


def tool_error(thing, states):
    """Where the tool was, less where it should be while the plan moves, RMS [m]."""
    following = [s for s in states if s.goal == "follow" and s.tool_truth is not None]
    goals = np.array([s.reference for s in following])
    moving = np.flatnonzero(np.any(np.diff(goals, axis=0) != 0.0, axis=1))
    following, goals = following[moving[0] : moving[-1] + 2], goals[moving[0] : moving[-1] + 2]
    error = thing.forward(goals)[:, :3, 3] - np.array([s.tool_truth[:3, 3] for s in following])
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--hardware", default="sim")
    parser.add_argument("--report", type=Path, help="a markdown file for the table")
    parser.add_argument("--dual-trajectory", action="store_true")
    parser.add_argument("--length", type=float, default=2.0)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that no server is left behind
    if options.dual_trajectory:
        dual_trajectory(options.length, options.seeds)
        return
    server = Server(options.hardware).ready()
    try:
        if options.page:
            took = page_stops(20)
            p50, p90 = np.percentile(took, [50, 90])
            say = f"STOP of the page, load {os.getloadavg()[0]:.1f}: median {p50:.1f} ms, nine of ten {p90:.1f} ms, "
            print(say + f"longest {took.max():.1f} ms of {len(took)} (bar 50 ms)")
            return
        rows = costs(server, min(10.0, 15.0 * options.minutes)) + ways(server, options.minutes)
    finally:
        server.end()
    print(told(rows, options.minutes))
    if options.report is not None:
        options.report.write_text(told(rows, options.minutes), encoding="utf-8")


if __name__ == "__main__":
    main()
