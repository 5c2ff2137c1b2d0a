"""Draw the pictures of the documentation into docs/images.

python docs/draw_images.py
"""

from pathlib import Path

import longreach as lr
from longreach.app.configuration import EstimateConfig, EvaluationConfig
from longreach.evaluation import figures

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    """Drive as `longreach demo` does, and draw the paths in the world of the simulation."""
    thing = lr.load_robot("thing")
    recording = lr.make_recording(thing, seed=0, duration=60.0)
    result = lr.estimate(recording, thing, EstimateConfig(evaluation=EvaluationConfig(align="none")))
    IMAGES.mkdir(exist_ok=True)
    figures.paths(result.trajectories).savefig(IMAGES / "demo_paths.png", dpi=90)


if __name__ == "__main__":
    main()
