"""Photos: painted surroundings of a face, the effects of a camera, and crops.

Surroundings are scenes of several kinds and of any colour, long hair and clothes. Lines, frames and
leaves in scenes have edges as sharp as those of the head, so that a search for the outline of a
face can go wrong.
"""

import io

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

_BLUR_PX = (0.3, 4.0)  # s.d. of the defocus, in a picture of 218 pixels
_PICTURE_PX = 218


def draw_background(size: int, rng: np.random.Generator) -> np.ndarray:
    """One square background of a random kind, `(size, size, 3)` float32, sRGB in [0, 1]."""
    return paint(KINDS[rng.integers(len(KINDS))], size, rng)


def paint(kind: str, size: int, rng: np.random.Generator) -> np.ndarray:
    """As `draw_background`, of one of `KINDS`."""
    picture = _PAINTERS[kind](size, rng)
    # Many are nearly sharp, some far out of focus.
    low, high = np.log(_BLUR_PX)
    blur = np.exp(rng.uniform(low, high)) * size / _PICTURE_PX
    return gaussian_filter(picture, (blur, blur, 0)).clip(0, 1)


def composite(
    picture: np.ndarray, layer: np.ndarray, depth: np.ndarray, opacity: float = 1.0
) -> None:
    """Paint a layer over a picture, in place.

    Args:
        picture: `(size, size, 3)` float.
        layer: `(size, size, 3)`, or one colour.
        depth: `(size, size)` pixels from the edge of the layer, positive within.
    """
    cover = opacity * np.clip(depth + 0.5, 0, 1)[..., None]
    picture += cover * (layer - picture)


def hair_depth(
    size: int, low: np.ndarray, high: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Depth of long hair behind a head, `(size, size)` as for `composite`.

    `low` and `high` `(2,)` are corners of the head's box from crown to chin, pixels, y down.
    """
    x, y = (axis * size for axis in _grid(size))
    (middle, ears), (half, half_height) = (low + high) / 2, (high - low) / 2
    below = (y - ears) / half_height
    volume, flare = rng.uniform(0.95, 1.15), rng.uniform(-0.15, 0.2)
    uneven = 1 + 0.03 * _cloud(size, 8, rng)
    width = volume * half * uneven * (1 + flare * below.clip(0))
    sides, above = np.abs(x - middle) / width, -below.clip(max=0) / rng.uniform(1.0, 1.08)
    beyond = (sides**2.5 + above**2.5) ** 0.4
    bottom = ears + rng.uniform(0.1, 1.6) * half_height * uneven
    return np.minimum((1 - beyond) * half, bottom - y)


def clothes_depth(
    size: int, collar: np.ndarray, neck: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Depths of clothes before neck and shoulders, and of the collar behind, as for `composite`.

    Args:
        collar: `(2,)` pixels, the lowest point of the neckline, y down.
        neck: Half its width in pixels.
    """
    x, y = (axis * size for axis in _grid(size))
    aside = np.abs(x - collar[0]) / neck
    rise, slope = rng.uniform(0.1, 0.35), rng.uniform(0.25, 0.5)
    line = collar[1] + neck * (slope * (aside - 1).clip(0) - rise * aside.clip(max=1) ** 2)
    behind = np.minimum(y - collar[1] + 1.2 * rise * neck, neck * (1 - aside))
    return y - line, behind


def draw_strands(size: int, rng: np.random.Generator) -> np.ndarray:
    """Brightness of hair that hangs down: `(1, size, 1)`, 0.8 on average."""
    return 0.8 + 0.08 * _cloud(size, 48, rng)[:1, :, None]


def _studio(size: int, rng: np.random.Generator) -> np.ndarray:
    """A screen, lit from a side or from the middle."""
    if rng.random() < 0.5:
        place = _stretched(_along(size, rng))
    else:
        x, y = _grid(size)
        centre = rng.uniform(0, 1, 2)
        place = np.hypot(x - centre[0], y - centre[1]) / 1.2
    return _ramp(_shades(rng), place)


def _clutter(size: int, rng: np.random.Generator) -> np.ndarray:
    """Noise of several octaves, such as leaves, stone or a crowd far away."""
    octaves = range(1, 7)
    place = sum(_cloud(size, 2**k, rng) / 2 ** (rng.uniform(0.4, 1.0) * k) for k in octaves)
    return _ramp(_colours(rng.integers(3, 5), rng), _stretched(place))


def _lights(size: int, rng: np.random.Generator) -> np.ndarray:
    """Lamps far out of focus before the dark."""
    picture = _ramp(_colours(2, rng) * 0.5, _stretched(_cloud(size, 3, rng)))
    x, y = _grid(size)
    radius = rng.uniform(0.015, 0.09)
    for colour in (0.5 + 0.5 * _colours(rng.integers(8, 25), rng)) * rng.uniform(0.4, 1):
        centre, r = rng.uniform(0, 1, 2), radius * rng.uniform(0.7, 1.3)
        first, last = np.int64((centre - r) * size).clip(0), np.int64((centre + r) * size) + 2
        box = np.s_[first[1] : last[1], first[0] : last[0]]
        disc = (r - np.hypot(x[box] - centre[0], y[box] - centre[1])) * size
        composite(picture[box], colour, disc, rng.uniform(0.3, 0.9))
    return picture


def _room(size: int, rng: np.random.Generator) -> np.ndarray:
    """A wall with windows, pictures, shelves and doors, most of them framed."""
    picture = _studio(size, rng)
    across, along = _turned(size, np.deg2rad(rng.normal(0, 2.5)))
    for _ in range(rng.integers(3, 8)):
        centre, half = rng.uniform(0, 1, 2), rng.uniform(0.03, 0.35, 2)
        sideways, above = np.abs(across - centre[0]), np.abs(along - centre[1])
        inside = np.minimum(half[0] - sideways, half[1] - above)
        frame, filling = _colours(2, rng)
        picture[inside > 0] = frame
        width = rng.uniform(0.005, 0.04)
        rows = along[inside > width, None]
        picture[inside > width] = filling * (1 + rng.normal(0, 0.3) * (rows - centre[1]))
    return picture


def _slats(size: int, rng: np.random.Generator) -> np.ndarray:
    """Parallel strips of any width: curtains, blinds, books, boards."""
    upright = rng.random() < 0.7
    place = _turned(size, np.deg2rad(rng.normal(0, 5)))[0 if upright else 1]
    edges = np.cumsum(rng.gamma(1.5, rng.uniform(0.01, 0.06), 160)) - 0.3
    tones = _ramp(_colours(3, rng), rng.random(161)) * rng.normal(1, 0.1, (161, 1))
    return tones[np.searchsorted(edges, place)]


def _banner(size: int, rng: np.random.Generator) -> np.ndarray:
    """The wall of signs that people are photographed at, or bricks and tiles."""
    across, along = _turned(size, np.deg2rad(rng.normal(0, 5)))
    height = rng.uniform(0.06, 0.25)
    row, v = np.divmod(along + rng.random(), height)
    column, u = np.divmod(across + 0.5 * row * height + rng.random(), 2 * height)
    # Each field holds one of a few patterns of coarse dots, which stand for letters.
    signs = rng.random((3, 6, 14)) < 0.5
    signs[:, [0, -1]] = signs[:, :, [0, -1]] = False
    which = np.int64(row + column) % 3
    inked = signs[which, np.int64(6 * v / height), np.int64(14 * u / (2 * height))]
    wall, ink = _shades(rng), _colours(2, rng)
    picture = _ramp(wall, _stretched(_along(size, rng)))
    picture[inked] = ink[which[inked] % 2]
    return picture


_PAINTERS = {p.__name__[1:]: p for p in (_studio, _clutter, _lights, _room, _slats, _banner)}
KINDS = tuple(_PAINTERS)


def _grid(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Places x and y of the pixels, `(size, size)` each, 0 to 1."""
    y, x = (np.indices((size, size), np.float32) + 0.5) / size
    return x, y


def _turned(size: int, angle: float) -> tuple[np.ndarray, np.ndarray]:
    x, y = _grid(size)
    return x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)


def _along(size: int, rng: np.random.Generator) -> np.ndarray:
    return _turned(size, rng.uniform(0, 2 * np.pi))[0]


def _cloud(size: int, cells: int, rng: np.random.Generator) -> np.ndarray:
    """Smooth noise with that many cells per side."""
    grid = Image.fromarray(np.float32(rng.standard_normal((cells + 1, cells + 1))))
    return np.asarray(grid.resize((size, size), Image.Resampling.BICUBIC))


def _stretched(values: np.ndarray) -> np.ndarray:
    return (values - values.min()) / np.ptp(values)


def _colours(n: int, rng: np.random.Generator) -> np.ndarray:
    """Random colours, most of them near grey: `(n, 3)`."""
    grey, colourful = rng.uniform(0.05, 0.95, (n, 1)), rng.gamma(2, 0.05, (n, 1))
    warm, green = rng.standard_normal((n, 1)), 0.4 * rng.standard_normal((n, 1))
    hue = np.hstack([warm - 0.5 * green, green, -warm - 0.5 * green])
    return np.float32((grey + colourful * hue).clip(0, 1))


def _shades(rng: np.random.Generator) -> np.ndarray:
    """Two shades of one colour: `(2, 3)`."""
    colour = _colours(1, rng)
    return np.concatenate([colour, colour * np.float32(rng.uniform(0.3, 0.9))])


def _ramp(colours: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Colours at places in [0, 1] between the first and the last."""
    stops = np.linspace(0, 1, len(colours))
    return np.stack([np.float32(np.interp(place, stops, c)) for c in colours.T], axis=-1)


def photograph(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Image as taken by a camera: exposure, colour cast, a little blur, noise, and JPEG.

    `(H, W, 3)` sRGB in [0, 1] becomes uint8.
    """
    light = np.float32(image) ** 2.2
    light *= np.float32(np.exp(rng.normal(0.05, 0.15) + rng.normal(0, (0.06, 0.02, 0.06))))
    photo = light.clip(0, 1) ** (1 / 2.2)
    blur = rng.uniform(0, 0.8)
    photo = gaussian_filter(photo, (blur, blur, 0))
    photo += 0.025 * rng.random() ** 2 * rng.standard_normal(photo.shape, np.float32)
    file = io.BytesIO()
    Image.fromarray(np.uint8(np.rint(255 * photo.clip(0, 1)))).save(
        file, "JPEG", quality=int(rng.integers(70, 96))
    )
    return np.asarray(Image.open(file))


def crop(
    image: np.ndarray, landmarks: np.ndarray, size: int, margin: float
) -> tuple[np.ndarray, np.ndarray]:
    """The square around the landmarks of a face, as for `renderer.square_frames`, edges repeated.

    Args:
        image: `(H, W, 3)` uint8.
        landmarks: `(L, 2)` pixels, x right and y down from the left upper corner.
        margin: Side of the square, in sizes of the landmarks' box.

    Returns:
        `(size, size, 3)` uint8, and the landmarks in it, `(L, 2)`.
    """
    low, high = landmarks.min(0), landmarks.max(0)
    side = margin * (high - low).max()
    corner = (low + high - side) / 2
    beyond = np.ceil(np.maximum([-corner, corner + side - image.shape[1::-1]], 0)).astype(int)
    (left, top), (right, bottom) = beyond
    wide = Image.fromarray(np.pad(image, ((top, bottom), (left, right), (0, 0)), mode="edge"))
    x, y = corner + (left, top)
    square = wide.resize((size, size), Image.Resampling.BICUBIC, (x, y, x + side, y + side))
    return np.asarray(square), (landmarks - corner) * (size / side)
