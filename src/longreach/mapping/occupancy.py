"""Occupancy grids: rendered from the beams of keyframes by ray tracing, written and read as map_server does.

A map keeps its beams, so a grid can be rendered at any resolution, any time, and is never what a map is made from.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from jaxtyping import Bool, Float

from longreach.errors import MappingError
from longreach.geometry import se2
from longreach.io.whole_files import whole_file, write_text
from longreach.mapping import _occupancy_kernels as kernels
from longreach.mapping.map_file import Map
from longreach.measurement import LaserScan

OCCUPIED, FREE = 0.65, 0.196  # map_server's thresholds
# Beams through a cell that weigh as much as one that ends in it: cells of a wall that is seen at a shallow angle are
# passed often. An even chance is then a quarter of the beams, from where on gmapping takes a cell as occupied.
_PASSES_A_HIT = 3.0
_MOST_CELLS = 4e8


@dataclass(frozen=True, eq=False)
class Occupancy:
    """A grid in the frame `map`: row 0 is the lowest y, column 0 the lowest x.

    probability (rows, columns): of being occupied, 0 to 1, where known (rows, columns) says that a beam was there.
    resolution: edge of a cell [m]. origin (3,): pose of the lower left corner of cell (0, 0) [m, m, rad].
    """

    probability: Float[np.ndarray, "rows columns"]
    known: Bool[np.ndarray, "rows columns"]
    resolution: float
    origin: Float[np.ndarray, "3"]

    @property
    def occupied(self) -> Bool[np.ndarray, "rows columns"]:
        """Which cells map_server takes as occupied."""
        return self.known & (self.probability > OCCUPIED)

    @property
    def free(self) -> Bool[np.ndarray, "rows columns"]:
        """Which cells map_server takes as free."""
        return self.known & (self.probability < FREE)


def render(map_: Map, resolution: float = 0.05) -> Occupancy:
    """Return the occupancy that the beams of all keyframes show.

    A beam without a return beyond the laser's range passes as far as its range, and no further than the farthest return
    of its scan: glass and black surfaces give none either. Other beams without a return say nothing.

    Raises:
        MappingError: no beam came back, the resolution is no length, or the grid would have too many cells.
    """
    if not 0 < resolution < np.inf:
        raise MappingError(f"A resolution of {resolution} m is no size of a cell; 0.05 m is usual.")
    parts = []
    for k, scan in enumerate(map_.scans):
        mount = map_.sessions[int(map_.session[k])].mounts[scan.frame]
        parts.append(beams(scan, mount, map_.graph.poses[k], map_.twists[k]))
    starts, ends, hit = (np.concatenate([part[m] for part in parts]) for m in range(3))
    if not np.any(hit):
        raise MappingError("No beam of the map's scans came back; there is nothing to draw.")
    low = np.floor(np.minimum(starts, ends).min(axis=0) / resolution) - 1
    columns, rows = map(int, np.floor(np.maximum(starts, ends).max(axis=0) / resolution) + 2 - low)
    if columns * rows > _MOST_CELLS:
        raise MappingError(f"A grid of {columns} × {rows} cells is too large; take a coarser resolution.")
    hits, passes = np.zeros((rows, columns), dtype=np.int32), np.zeros((rows, columns), dtype=np.int32)
    kernels.trace(starts / resolution - low, ends / resolution - low, hit, hits, passes)
    known = hits + passes > 0
    probability = _PASSES_A_HIT * hits / np.maximum(_PASSES_A_HIT * hits + passes, 1)
    return Occupancy(probability, known, resolution, np.array([*(low * resolution), 0.0]))


def beams(
    scan: LaserScan,
    T_base_laser: Float[np.ndarray, "4 4"],
    pose: Float[np.ndarray, "3"],
    twist: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "k 2"], Float[np.ndarray, "k 2"], Bool[np.ndarray, " k"]]:
    """Return where the beams of a scan start and end in the frame `map` [m], and (k,) which of them hit something.

    pose: T_map_base at the scan's stamp; twist: of the base during the sweep.
    """
    ranges, farthest = scan.returns, np.max(scan.returns, initial=0.0)
    hit = ranges > 0
    beyond = (scan.ranges > scan.range_max) | np.isposinf(scan.ranges)
    length = np.where(hit, ranges, np.where(beyond, min(scan.range_max, farthest), 0.0))
    kept = length > 0
    length, angles, hit = length[kept], scan.angles[kept], hit[kept]
    turned = np.column_stack([np.cos(angles) * length, np.sin(angles) * length])
    p_base = turned @ T_base_laser[:2, :2].T + T_base_laser[:2, 3]
    late = scan.time_increment * np.arange(len(scan.ranges))[kept]
    at = se2.retract(np.broadcast_to(pose, (len(late), 3)), late[:, None] * twist)
    c, s = np.cos(at[:, 2]), np.sin(at[:, 2])

    def in_map(p: np.ndarray) -> np.ndarray:
        return np.column_stack([at[:, 0] + c * p[:, 0] - s * p[:, 1], at[:, 1] + s * p[:, 0] + c * p[:, 1]])

    return in_map(np.broadcast_to(T_base_laser[:2, 3], p_base.shape)), in_map(p_base), hit


def write_map_server(path: Path, occupancy: Occupancy) -> None:
    """Write the image PATH (map.pgm) and beside it the description (map.yaml), as map_server's map_saver does.

    Occupied cells are 0, free ones 254, all others 205; the first row of the image has the highest y.
    """
    image = np.full(occupancy.known.shape, 205, dtype=np.uint8)
    image[occupancy.free], image[occupancy.occupied] = 254, 0
    size = " ".join(map(str, image.shape[::-1]))
    header = f"P5\n# CREATOR: longreach {occupancy.resolution:.3f} m/pix\n{size}\n255\n"
    with whole_file(path) as temporary:
        temporary.write_bytes(header.encode() + image[::-1].tobytes())
    x, y, yaw = occupancy.origin.tolist()
    write_text(
        path.with_suffix(".yaml"),
        f"image: {path.name}\nmode: trinary\nresolution: {occupancy.resolution!r}\norigin: [{x!r}, {y!r}, {yaw!r}]\n"
        f"negate: 0\noccupied_thresh: {OCCUPIED}\nfree_thresh: {FREE}\n",
    )


def read_map_server(path: Path) -> Occupancy:
    """Read a map of map_server by its description (map.yaml), with an image as PGM, PNG or what else Pillow reads.

    By map_server's rules: a pixel p, the mean of its colours, is (255 − p)/255 occupied, or p/255 with `negate`.
    trinary: occupied above occupied_thresh, free below free_thresh, else unknown. scale: in between a probability in
    proportion, 0.01 to 0.99, unknown where the image is transparent. raw: p is the percentage, above 100 unknown.

    Raises:
        MappingError: a file is not there or cannot be read, or a key of the description is missing or means nothing.
    """
    try:
        keys = yaml.safe_load(path.read_text(encoding="utf-8"))
        image = Path(str(keys["image"]))
        resolution, origin = float(keys["resolution"]), np.array(keys["origin"], dtype=float)
        negate, mode = bool(int(keys.get("negate", 0))), str(keys.get("mode", "trinary"))
        occupied, free = float(keys.get("occupied_thresh", OCCUPIED)), float(keys.get("free_thresh", FREE))
    except FileNotFoundError as error:
        raise MappingError(f"{path} is not there.") from error
    except OSError as error:
        raise MappingError(f"{path} cannot be read: {error.strerror or error}.") from error
    except KeyError as error:
        raise MappingError(f"{path} does not say the map's {error.args[0]}.") from error
    except (yaml.YAMLError, TypeError, ValueError, AttributeError) as error:
        raise MappingError(f"{path} is no description of a map as map_server writes it: {_line(error)}.") from error
    if mode not in ("trinary", "scale", "raw"):
        raise MappingError(f"{path} has the mode {mode!r}; map_server has trinary, scale and raw.")
    if not 0 < resolution < np.inf or origin.shape != (3,) or not np.all(np.isfinite(origin)):
        raise MappingError(f"{path} needs a resolution [m] above 0 and an origin [x, y, yaw].")
    colour, alpha = _pixels(path.parent / image)
    colour = 255.0 - colour if negate else colour
    if mode == "raw":
        return Occupancy(np.clip(colour / 100.0, 0.0, 1.0), colour <= 100, resolution, origin)
    value = (255.0 - colour) / 255.0
    between = (value >= free) & (value <= occupied)
    share = np.clip((value - free) / max(occupied - free, 1e-9), 0.0, 1.0)
    probability = np.where(between, 0.01 + 0.98 * share, np.where(value > occupied, 1.0, 0.0))
    known = ~between | (alpha >= 255) if mode == "scale" else ~between
    return Occupancy(probability, known, resolution, origin)


def _pixels(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of the colours and the opacity of each pixel, 0 to 255, with the lowest row first."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            if image.mode in ("P", "1", "CMYK"):
                image = image.convert("RGBA" if "transparency" in image.info else "RGB")
            pixels = np.asarray(image, dtype=float)
            if image.mode.startswith("I") or image.mode == "F":
                pixels = pixels / 257.0  # 16 bits
    except FileNotFoundError as error:
        raise MappingError(f"{path}, the image of a map, is not there.") from error
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError) as error:
        raise MappingError(f"{path} cannot be read as an image: {_line(error)}.") from error
    pixels = pixels.reshape(*pixels.shape[:2], -1)[::-1]
    colours = pixels.shape[2] - (pixels.shape[2] in (2, 4))
    opaque = np.full(pixels.shape[:2], 255.0)
    return pixels[:, :, :colours].mean(axis=2), pixels[:, :, -1] if colours < pixels.shape[2] else opaque


def _line(error: Exception) -> str:
    return " ".join(str(error).split()).rstrip(".")
