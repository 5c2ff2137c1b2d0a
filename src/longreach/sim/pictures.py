"""What cameras of the simulated world see."""

from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from longreach.errors import ConfigError
from longreach.sim.mujoco_model import engine

Trail = tuple[tuple[float, float, float], np.ndarray]  # colour RGB from 0 to 1, points (n, 3) [m]

_MOST_POINTS = 400  # of a path in a picture
_THICKNESS = 3.0  # of it [pixel]


class Pictures:
    """MuJoCo's renderer, made when the first picture is asked for and again when its size changes."""

    def __init__(self, model: Any) -> None:
        self._model, self._renderer = model, None
        self._cameras = [model.camera(i).name for i in range(model.ncam)]

    @cached_property
    def possible(self) -> bool:
        """Whether there is something to draw with."""
        try:
            self._opened(64, 64).close()
        except ConfigError:
            return False
        return True

    def draw(
        self, data: Any, camera: str, width: int, height: int, trails: Sequence[Trail] = ()
    ) -> UInt8[np.ndarray, "h w 3"]:
        """Return a picture (height, width, 3), RGB.

        Raises:
            ConfigError: there is no such camera, the picture is too large, or there is nothing to draw with.
        """
        if camera not in self._cameras:
            raise ConfigError(f"There is no camera {camera!r}; there are {', '.join(self._cameras)}.")
        if not (0 < width <= 1920 and 0 < height <= 1080):
            raise ConfigError(f"Pictures are up to 1920 by 1080 large, but {width} by {height} was asked for.")
        renderer = self._fitting(width, height)
        renderer.update_scene(data, camera=camera)
        for colour, points in trails:
            _hang(renderer.scene, colour, np.asarray(points, dtype=float))
        return np.array(renderer.render())

    def _fitting(self, width: int, height: int) -> Any:
        """Return a renderer of this size."""
        renderer: Any = self._renderer
        if renderer is None or (renderer.width, renderer.height) != (width, height):
            self.close()
            renderer = self._renderer = self._opened(width, height)
            renderer.scene.flags[engine().mjtRndFlag.mjRND_SHADOW] = (
                0  # without a graphics card they take most of the time
            )
        return renderer

    def _opened(self, width: int, height: int) -> Any:
        mujoco = engine()
        try:
            return mujoco.Renderer(self._model, height, width)
        except Exception as error:  # whatever the graphics library raises: it is not there, or has no screen
            raise ConfigError(
                "There is nothing to draw pictures with; install EGL (libegl1 on Debian), or set MUJOCO_GL to osmesa "
                "and install OSMesa."
            ) from error

    def close(self) -> None:
        """Give the graphics library's memory back."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def _hang(scene: Any, colour: tuple[float, float, float], points: Float[np.ndarray, "n 3"]) -> None:
    """Add a path to a scene, as thin lines; of a long one only so many points that there is room for it."""
    mujoco = engine()
    if len(points) > _MOST_POINTS:
        points = points[np.linspace(0, len(points) - 1, _MOST_POINTS).astype(int)]
    kind = mujoco.mjtGeom.mjGEOM_LINE
    for p, q in pairwise(points):
        if scene.ngeom >= scene.maxgeom:
            return
        part, rgba = scene.geoms[scene.ngeom], np.array([*colour, 1.0], dtype=np.float32)
        mujoco.mjv_initGeom(part, kind, np.zeros(3), np.zeros(3), np.zeros(9), rgba)
        mujoco.mjv_connector(part, kind, _THICKNESS, p, q)
        scene.ngeom += 1
