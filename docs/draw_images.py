"""Draw the pictures of the documentation into docs/images.

python docs/draw_images.py
"""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from longreach.app.dual_trajectory import DualTrajectoryConfig, execute_both
from longreach.evaluation.execution_figures import tool_and_base
from longreach.sim.long_drive import long_drive
from longreach.sim.worlds import load_world

IMAGES = Path(__file__).parent / "images"


def worlds() -> Figure:
    """Draw the worlds that have ways as a laser sees them, and a drive of 300 m through each."""
    fig = Figure(figsize=(9.0, 11.5), layout="constrained")
    FigureCanvasAgg(fig)
    sizes = [30, 40, 16]
    for axes, name in zip(fig.subplots(3, 1, height_ratios=sizes), ("building", "storehouse", "twins"), strict=True):
        world = load_world(name)
        seen, drive = world.at_height(0.233), long_drive(world, 300.0, seed=4)
        axes.add_collection(LineCollection(seen.reshape(-1, 2, 2).tolist(), colors="0.25", linewidths=0.7))
        axes.plot(*drive.poses[:, :2].T, color="tab:orange", linewidth=1.0)
        axes.plot(0.0, 0.0, "o", color="tab:orange", markersize=4)
        axes.set(title=name, aspect="equal", xlabel="x [m]", ylabel="y [m]")
    return fig


def main() -> None:
    """Draw the line that `longreach run dual-trajectory` draws with the loop closed, and the worlds."""
    IMAGES.mkdir(exist_ok=True)
    worlds().savefig(IMAGES / "worlds.png", dpi=80)
    runs = execute_both(DualTrajectoryConfig(), 0, lambda stage, fraction: None)
    tool_and_base(runs["closed"].traces).savefig(IMAGES / "tool_and_base.png", dpi=90)


if __name__ == "__main__":
    main()
