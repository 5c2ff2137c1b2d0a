"""What a page gathers while it watches: driven paths and the map, in few nodes however long it goes on."""

import numpy as np
from jaxtyping import Float

from longreach.view.scene import COLOURS, Scene

_STEP = 0.05  # between two points of a path [m]
_CELL = 0.04  # of the map [m]
_TAIL = 50  # points that are drawn anew with each new one; those before lie still
_MOST_POINTS = 2000  # of a path: beyond, every second of its older half goes
_MOST_CELLS = 60_000


class Trail:
    """A driven path as two nodes: a short end that grows, and all before it."""

    def __init__(self, scene: Scene, name: str) -> None:
        self._scene, self._name = scene, name
        self.points: list[np.ndarray] = []
        self._settled = 0  # points in the node that lies still

    def grow(self, point: Float[np.ndarray, "3"]) -> None:
        """Go on to a point [m], where it is away from the last."""
        if self.points and np.linalg.norm(point - self.points[-1]) < _STEP:
            return
        self.points.append(point)
        if len(self.points) > _MOST_POINTS:
            half = _MOST_POINTS // 2
            self.points[:half] = self.points[:half:2]
            self._settle()
        elif len(self.points) - self._settled > _TAIL:
            self._settle()
        elif len(self.points) > 1:
            self._draw("end", self.points[max(self._settled - 1, 0) :])

    def _settle(self) -> None:
        self._draw("whole", self.points)
        self._settled = len(self.points)

    def _draw(self, part: str, points: list[np.ndarray]) -> None:
        self._scene.add_path(f"{self._name}/{part}", np.array(points), COLOURS[self._name])


class GrowingMap:
    """The cells of the floor that returns fell into, as two nodes like a trail's."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._cells: dict[tuple[int, int], None] = {}
        self._settled = 0

    @property
    def points(self) -> Float[np.ndarray, "m 2"]:
        """The cells' middles [m]."""
        return _CELL * np.array(list(self._cells), dtype=float).reshape(-1, 2)

    def grow(self, returns: Float[np.ndarray, "k 2"]) -> None:
        """Take the returns of a sweep [m], in map's frame."""
        before = len(self._cells)
        if before < _MOST_CELLS:
            self._cells.update(dict.fromkeys(map(tuple, np.round(returns / _CELL).astype(int).tolist())))
        count = len(self._cells)
        if count == before:
            return
        if count - self._settled > max(500, self._settled // 4):
            self._draw("whole", 0)
            self._settled = count
        else:
            self._draw("end", self._settled)

    def _draw(self, part: str, since: int) -> None:
        points = self.points[since:]
        self._scene.add_cloud(f"/map/{part}", np.column_stack([points, np.full(len(points), 0.012)]))
