"""Draw the light of a drive, and shade surfaces: sun, shadow, patterns, haze, sky, exposure."""

from typing import NamedTuple

import numpy as np

from pipeline.camera import classes
from pipeline.sample.plan import ASPHALT, BAY, GRASS, KERB_M, KERBSTONE, MARKING, PAVEMENT, STOREY_M
from pipeline.sample.world import Hits, dot_product

# Side of a pattern's tile in cells. It is a power of two, so that _look_up can repeat the tile by a
# bit mask.
_TILE = 256
# Largest brightness that the tone curve has a value for; the smallest is 0.
_STEPS = 4095
# Shift of the grain on vertical faces, in metres per metre along x. Windows and boards are not
# shifted.
_SHIFT = np.float32(0.37)

# Colour of the sky at the horizon.
_HORIZON = np.array([0.75, 0.82, 0.88])
# Colour of the clear sky at the zenith.
_BLUE = np.array([0.22, 0.42, 0.80])
# Colour of the overcast sky at the zenith.
_GREY = np.array([0.60, 0.64, 0.70])


class Light(NamedTuple):
    """The light of a drive. Colours are linear RGB [3]."""

    sun: np.ndarray  # float32 [3], direction towards the sun
    sun_colour: np.ndarray
    ambient: np.ndarray  # colour of the light from the sky
    zenith: np.ndarray  # colour of the sky at the zenith
    haze_m: float  # distance at which haze leaves 1/e of a surface's contrast
    exposure: float  # factor on brightness
    curve: np.ndarray  # uint8 [_STEPS + 1], tone curve: brightness → value of a pixel
    slope: np.ndarray  # [2], change of brightness over the image's width and height
    grain: np.ndarray  # float32 [_TILE,_TILE], fine pattern in -1..1
    patches: np.ndarray  # float32 [_TILE,_TILE], coarse pattern in -1..1
    clouds: float  # contrast of clouds


def draw_light(rng: np.random.Generator) -> Light:
    """Draw the light of a drive."""
    overcast = rng.uniform(0, 1) ** 1.5 * 0.8  # sunny drives are more frequent
    azimuth = rng.uniform(0, 2 * np.pi)
    elevation = np.deg2rad(rng.uniform(18, 60))
    east = np.cos(azimuth) * np.cos(elevation)
    north = np.sin(azimuth) * np.cos(elevation)
    up = np.sin(elevation)
    warm = rng.uniform(-0.08, 0.10)

    haze_m = rng.uniform(500, 2000)
    exposure = rng.uniform(0.65, 1.35)
    gamma = rng.uniform(1.8, 2.5)
    slope = rng.uniform(-0.25, 0.25, 2)
    grain = rng.uniform(-1, 1, (_TILE, _TILE))
    patches = _draw_patches(rng)
    clouds = rng.uniform(0.05, 0.3)
    return Light(
        sun=np.array([east, north, up], np.float32),
        sun_colour=(1.7 - 1.6 * overcast) * np.array([1 + warm, 1.0, 1 - warm]),
        ambient=(0.30 + 0.45 * overcast) * np.array([0.92, 1.0, 1.1]),
        zenith=(1 - overcast) * _BLUE + overcast * _GREY,
        haze_m=haze_m,
        exposure=exposure,
        curve=np.rint(255 * np.linspace(0, 1, _STEPS + 1) ** (1 / gamma)).astype(np.uint8),
        slope=slope,
        grain=grain.astype(np.float32),
        patches=patches.astype(np.float32),
        clouds=clouds,
    )


def draw_ground_colours(rng: np.random.Generator) -> np.ndarray:
    """Draw the albedo of each kind of ground in the plan, [6,3]."""
    colours = np.zeros((6, 3))
    asphalt = rng.uniform(0.13, 0.24)
    colours[ASPHALT] = np.array([1, 1, 1.03]) * asphalt
    colours[BAY] = np.array([1.05, 1, 0.97]) * asphalt * rng.uniform(0.75, 1.3)
    colours[MARKING] = 0.72
    colours[PAVEMENT] = np.array([1.03, 1, 0.95]) * rng.uniform(0.34, 0.50)
    colours[KERBSTONE] = rng.uniform(0.45, 0.6)
    colours[GRASS] = np.array([0.20, 0.30, 0.10]) * rng.uniform(0.75, 1.2)
    colours[GRASS] += [rng.uniform(0, 0.08), 0, 0]
    return colours


def shade_pixels(
    light: Light, hits: Hits, rays: np.ndarray, lit: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """Return the image that `hits` of `rays` [6,N] make, RGB uint8 [H,W,3] with N = H·W.

    `lit` bool [N] tells which surfaces are not in shadow.
    """
    sky = np.flatnonzero(hits.cls == classes.SKY)
    distance_m = hits.distance_m.copy()
    distance_m[sky] = 0
    points = rays[:3] + distance_m * rays[3:]

    # Surfaces reflect the sun and the sky. Faces that look upwards see more of the sky.
    direct = np.maximum(dot_product(hits.normal, light.sun), 0) * lit
    from_sky = 0.75 + 0.25 * hits.normal[2]
    colour = direct * _as_column(light.sun_colour) + from_sky * _as_column(light.ambient)  # [3,N]
    colour *= hits.colour
    colour *= 1 + _surface_pattern(light, hits, points)

    # With distance, surfaces fade to the colour of the horizon.
    haze = 1 - np.exp(-distance_m / np.float32(light.haze_m))
    colour += haze * (_as_column(_HORIZON) - colour)
    colour[:, sky] = _sky_colour(light, rays[3:, sky])

    # The camera exposes the image, unevenly over its width and height.
    height, width = size
    slope_x, slope_y = light.slope
    slope = slope_x * np.linspace(-1, 1, width) + slope_y * np.linspace(-1, 1, height)[:, None]
    colour *= (_STEPS * light.exposure * (1 + slope)).astype(np.float32).ravel()
    np.clip(colour, 0, _STEPS, out=colour)
    image = light.curve.take(colour.astype(np.int16)).reshape(3, height, width)
    return np.ascontiguousarray(image.transpose(1, 2, 0))


def _as_column(colour: np.ndarray) -> np.ndarray:
    """Return a colour [3] as float32 [3,1]."""
    return colour.astype(np.float32)[:, None]


def _surface_pattern(light: Light, hits: Hits, points: np.ndarray) -> np.ndarray:
    """Return the relative brightness of patterns [N]: grain, joints, windows, boards."""
    x, y, z = points
    normal_x, normal_y, normal_z = hits.normal

    # Patterns of the ground are along x and y, those of vertical faces along the face and upwards.
    on_ground = hits.ground >= 0
    along = np.where(on_ground, x, _SHIFT * x + y * normal_x - x * normal_y)
    up = np.where(on_ground, y, z)
    pattern = _grain_pattern(light, hits, along, up)

    # Pavement has joints of 7 cm between its slabs, every 0.8 m.
    slabs = np.flatnonzero(hits.ground == PAVEMENT)
    joint = (np.mod(along[slabs], 0.8) < 0.07) | (np.mod(up[slabs], 0.8) < 0.07)
    pattern[slabs] -= 0.15 * joint

    wall = np.flatnonzero((hits.cls == classes.BUILDING) & (np.abs(normal_z) < 0.1))
    pattern[wall] -= _window_pattern(along[wall] - _SHIFT * x[wall], z[wall] - KERB_M)

    # Wooden fences have gaps between their boards. They are told from barriers by their colours.
    red, _, blue = hits.colour
    fence = np.flatnonzero((hits.cls == classes.FENCE) & (blue > 0.12) & (red < 0.6))
    gap = np.mod(along[fence] - _SHIFT * x[fence], 0.35) < 0.08
    pattern[fence] -= 0.35 * gap
    return np.maximum(pattern, np.float32(-0.9))


def _grain_pattern(light: Light, hits: Hits, along: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Return the relative brightness of grain and patches, [N]. The grain of leaves is coarser."""
    leaves = hits.cls == classes.VEGETATION
    contrast = np.full(len(along), 0.08, np.float32)
    contrast[hits.ground == GRASS] = 0.22
    contrast[leaves] = 0.30
    per_m = np.where(leaves, np.float32(1 / 0.35), np.float32(1 / 0.15))
    grain = contrast * _look_up(light.grain, along * per_m, up * per_m)
    patches = np.float32(0.16) * _look_up(light.patches, along * 2, up * 2)
    return grain + patches


def _window_pattern(along: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Return by how much windows, and a band between storeys, are darker than a wall, [M]."""
    # Windows are 1.1 m wide, with 2.6 m from one to the next. They are 1.4 m high in each storey.
    storey_m = np.mod(up, STOREY_M)
    window = np.abs(np.mod(along, 2.6) - 1.3) < 0.55
    window &= (np.abs(storey_m - 1.7) < 0.7) & (up > 0.5)
    return 0.65 * window + 0.12 * (storey_m < 0.2)


def _sky_colour(light: Light, direction: np.ndarray) -> np.ndarray:
    """Return the sky's colour [3,N] in `direction` [3,N]."""
    x, y, z = direction
    up = np.clip(z, 0.02, 1)
    blend = np.sqrt(np.clip(up * 1.6, 0, 1))
    clear = _as_column(_HORIZON) * (1 - blend) + _as_column(light.zenith) * blend
    cloud = _look_up(light.patches, x / up * 6, y / up * 6) * light.clouds
    to_sun = np.clip(dot_product(direction, light.sun), 0, 1)
    glow = to_sun**16 * light.sun_colour.mean() * 0.3
    return (clear + cloud + glow).astype(np.float32)


def _look_up(tile: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the values [N] of a tile, which repeats endlessly, at places in units of cells."""
    row = np.floor(y).astype(np.int32) & (_TILE - 1)
    column = np.floor(x).astype(np.int32) & (_TILE - 1)
    return tile.ravel().take(row * _TILE + column)


def _draw_patches(rng: np.random.Generator) -> np.ndarray:
    """Draw a tile of soft patches that repeats without seams."""
    # Filter noise by a Gaussian, in the spectrum.
    spectrum = np.fft.rfft2(rng.uniform(-1, 1, (_TILE, _TILE)))
    frequency_y = np.fft.fftfreq(_TILE)[:, None]
    frequency_x = np.fft.rfftfreq(_TILE)
    spectrum *= np.exp(-((frequency_y**2 + frequency_x**2) * 2 * (np.pi * 3.0) ** 2))
    patches = np.fft.irfft2(spectrum, s=(_TILE, _TILE))
    return patches / np.abs(patches).max()
