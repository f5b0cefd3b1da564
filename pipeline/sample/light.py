"""Shade surfaces: sun and shadow, surface patterns, haze, sky, exposure. One draw per drive."""

from typing import NamedTuple

import numpy as np

from pipeline.camera import classes
from pipeline.sample.plan import ASPHALT, BAY, GRASS, KERBSTONE, MARKING, PAVEMENT
from pipeline.sample.world import Hits, dot

_TILE = 256  # side of the pattern tiles; a power of two, see _look_up
_STEPS = 4095

_BLUE, _GREY = np.array([0.22, 0.42, 0.80]), np.array([0.60, 0.64, 0.70])


class Light(NamedTuple):
    """One drive's light. Colours are linear RGB."""

    sun: np.ndarray  # [3] direction towards the sun
    sun_colour: np.ndarray
    ambient: np.ndarray
    sky: tuple[np.ndarray, np.ndarray]  # colour at the horizon, at the zenith
    haze_m: float
    exposure: float
    curve: np.ndarray  # uint8 [_STEPS + 1]: tone curve
    slope: np.ndarray  # [2] change of brightness over the image's width and height
    tiles: np.ndarray  # [2, TILE, TILE] patterns in -1..1: fine, coarse
    clouds: float


def draw_light(rng: np.random.Generator) -> Light:
    """Draw the light of a drive."""
    overcast = rng.uniform(0, 1) ** 1.5 * 0.8  # sunny more often than not
    azimuth, elevation = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(18, 60))
    sun = np.array(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    warm = rng.uniform(-0.08, 0.10)
    return Light(
        sun=sun,
        sun_colour=(1.7 - 1.6 * overcast) * np.array([1 + warm, 1.0, 1 - warm]),
        ambient=(0.30 + 0.45 * overcast) * np.array([0.92, 1.0, 1.1]),
        sky=(np.array([0.75, 0.82, 0.88]), (1 - overcast) * _BLUE + overcast * _GREY),
        haze_m=rng.uniform(500, 2000),
        exposure=rng.uniform(0.65, 1.35),
        curve=np.rint(255 * np.linspace(0, 1, _STEPS + 1) ** (1 / rng.uniform(1.8, 2.5))).astype(
            np.uint8
        ),
        slope=rng.uniform(-0.25, 0.25, 2),
        tiles=np.stack([rng.uniform(-1, 1, (_TILE, _TILE)), _smooth(rng)]).astype(np.float32),
        clouds=rng.uniform(0.05, 0.3),
    )


def draw_ground_colours(rng: np.random.Generator) -> np.ndarray:
    """Draw the albedo [6,3] of each kind of ground of the plan."""
    colours = np.zeros((6, 3))
    asphalt = rng.uniform(0.13, 0.24)
    colours[ASPHALT] = np.array([1, 1, 1.03]) * asphalt
    colours[BAY] = np.array([1.05, 1, 0.97]) * asphalt * rng.uniform(0.75, 1.3)
    colours[MARKING] = 0.72
    colours[PAVEMENT] = np.array([1.03, 1, 0.95]) * rng.uniform(0.34, 0.50)
    colours[KERBSTONE] = rng.uniform(0.45, 0.6)
    colours[GRASS] = np.array([0.20, 0.30, 0.10]) * rng.uniform(0.75, 1.2) + [
        rng.uniform(0, 0.08),
        0,
        0,
    ]
    return colours


def shade(
    light: Light, hits: Hits, rays: np.ndarray, lit: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """Return the image, RGB uint8 [H,W,3], of `hits` along `rays` [6,N], N = H·W; `lit` bool [N]:
    not in shadow.
    """
    sky = np.flatnonzero(hits.cls == classes.SKY)
    distance = hits.distance_m.copy()
    distance[sky] = 0
    points = rays[:3] + distance * rays[3:]
    sun_colour, ambient, horizon, zenith = (
        part.astype(np.float32)[:, None] for part in (light.sun_colour, light.ambient, *light.sky)
    )
    direct = np.maximum(dot(hits.normal, light.sun.astype(np.float32)), 0) * lit
    # Upward faces receive more light from the sky.
    from_sky = 0.75 + 0.25 * hits.normal[2]
    colour = direct * sun_colour + from_sky * ambient  # [3,N]
    colour *= hits.colour
    colour *= 1 + _pattern(light, hits, points)
    colour += (1 - np.exp(-distance / np.float32(light.haze_m))) * (horizon - colour)
    colour[:, sky] = _sky(light, rays[3:, sky], horizon, zenith)

    height, width = size
    across = (
        light.slope[0] * np.linspace(-1, 1, width)
        + light.slope[1] * np.linspace(-1, 1, height)[:, None]
    )
    colour *= (_STEPS * light.exposure * (1 + across)).astype(np.float32).ravel()
    np.clip(colour, 0, _STEPS, out=colour)
    picture = light.curve.take(colour.astype(np.int16)).reshape(3, height, width)
    return np.ascontiguousarray(picture.transpose(1, 2, 0))


def _pattern(light: Light, hits: Hits, points: np.ndarray) -> np.ndarray:
    """Return each surface's relative brightness [N]: grain, patches, windows."""
    x, y, z = points
    ground = hits.ground >= 0
    # Vertical faces are patterned along the street and upwards.
    along = np.where(ground, x, np.float32(0.37) * x + y * hits.normal[0] - x * hits.normal[1])
    up = np.where(ground, y, z)
    leaves = hits.cls == classes.VEGETATION
    grain = np.where(
        leaves, np.float32(0.30), np.where(hits.ground == GRASS, np.float32(0.22), np.float32(0.08))
    )
    per_m = np.where(leaves, np.float32(1 / 0.35), np.float32(1 / 0.15))
    pattern = grain * _look_up(light.tiles[0], along * per_m, up * per_m)
    pattern += np.float32(0.16) * _look_up(light.tiles[1], along * 2, up * 2)
    slabs = np.flatnonzero(hits.ground == PAVEMENT)
    joint = (np.mod(along[slabs], 0.8) < 0.07) | (np.mod(up[slabs], 0.8) < 0.07)
    pattern[slabs] -= 0.15 * joint

    wall = np.flatnonzero((hits.cls == classes.BUILDING) & (np.abs(hits.normal[2]) < 0.1))
    u, v = along[wall] - 0.37 * x[wall], z[wall] - 0.12
    # Windows and a band between storeys.
    storey_m = np.mod(v, 2.9)
    window = (np.abs(np.mod(u, 2.6) - 1.3) < 0.55) & (np.abs(storey_m - 1.7) < 0.7) & (v > 0.5)
    pattern[wall] -= 0.65 * window + 0.12 * (storey_m < 0.2)
    fence = np.flatnonzero(
        (hits.cls == classes.FENCE) & (hits.colour[2] > 0.12) & (hits.colour[0] < 0.6)
    )
    pattern[fence] -= 0.35 * (np.mod(along[fence] - 0.37 * x[fence], 0.35) < 0.08)
    return np.maximum(pattern, np.float32(-0.9))


def _sky(
    light: Light, direction: np.ndarray, horizon: np.ndarray, zenith: np.ndarray
) -> np.ndarray:
    """Return the sky's colour [3,N] in `direction` [3,N], from its colours [3,1] at horizon and
    zenith.
    """
    up = np.clip(direction[2], 0.02, 1)
    blend = np.sqrt(np.clip(up * 1.6, 0, 1))
    cloud = _look_up(light.tiles[1], direction[0] / up * 6, direction[1] / up * 6) * light.clouds
    glow = (
        np.clip(dot(direction, light.sun.astype(np.float32)), 0, 1) ** 16
        * light.sun_colour.mean()
        * 0.3
    )
    return (horizon * (1 - blend) + zenith * blend + cloud + glow).astype(np.float32)


def _look_up(tile: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    row, column = (np.floor(along).astype(np.int32) & (_TILE - 1) for along in (y, x))
    return tile.ravel().take(row * _TILE + column)


def _smooth(rng: np.random.Generator) -> np.ndarray:
    """Draw a tile of soft patches that repeats without seams."""
    noise = np.fft.rfft2(rng.uniform(-1, 1, (_TILE, _TILE)))
    fy, fx = np.fft.fftfreq(_TILE)[:, None], np.fft.rfftfreq(_TILE)[None]
    patches = np.fft.irfft2(
        noise * np.exp(-((fy**2 + fx**2) * 2 * (np.pi * 3.0) ** 2)), s=(_TILE, _TILE)
    )
    return patches / np.abs(patches).max()
