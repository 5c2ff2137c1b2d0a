"""Draw the pictures of the documentation into docs/images.

python docs/draw_images.py
"""

from pathlib import Path

from longreach.app.dual_trajectory import DualTrajectoryConfig, execute_both
from longreach.evaluation.execution_figures import tool_and_base

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    """Draw the line that `longreach run dual-trajectory` draws with the loop closed."""
    runs = execute_both(DualTrajectoryConfig(), 0, lambda stage, fraction: None)
    IMAGES.mkdir(exist_ok=True)
    tool_and_base(runs["closed"].traces).savefig(IMAGES / "tool_and_base.png", dpi=90)


if __name__ == "__main__":
    main()
