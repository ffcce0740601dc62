"""The wet picture, drawn in chunks of vectors, against the same formulas pixel by pixel."""

import numpy as np
import pytest

from rainsim import chunks, grade, shade, sky
from rainsim.light import bilinear

F4 = np.float32
HEIGHT, WIDTH, CELLS = 3, grade.CHUNK + 37, 40
ORIGIN, SPACING, UNIT = F4([-2, -2]), F4(0.1), F4(0.5)
LENS = F4([200, 210, WIDTH / 2, HEIGHT / 2])
EYE = F4([0, 0, 1])
TURN = np.array([[1, 0, 0], [0, -0.3, 0.954], [0, -0.954, -0.3]], F4)  # looks down a little


@pytest.fixture
def dry():
    """Everything at random: ground, walls, half covered pixels, sky, places off the map."""
    rng = np.random.default_rng(4)
    normal = rng.normal(size=(HEIGHT, WIDTH, 3))
    normal[:, ::2] = TURN.T @ (0, 0, 1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    depth = rng.uniform(1, 9, (HEIGHT, WIDTH))
    depth[:, ::2] = rng.uniform(3, 8, (HEIGHT, 1))
    depth[rng.uniform(size=depth.shape) < 0.1] = 90
    alpha = np.minimum(rng.uniform(0, 3, depth.shape), 1)
    return {
        "color": rng.uniform(-0.1, 1.3, (HEIGHT, WIDTH, 3)).astype(F4),
        "alpha": alpha.astype(F4),
        "depth": np.where(alpha < 0.02, np.inf, depth).astype(F4),
        "plane_depth": np.where(alpha < 0.02, np.inf, depth * 1.02).astype(F4),
        "normal": normal.astype(F4),
        "bed": rng.normal(0, 0.2, (CELLS, CELLS)).astype(F4),
        "ground": rng.uniform(0, 1, (CELLS, CELLS, 5)).astype(F4),
    }


def pixel_by_pixel(dry, around, day, look, others, apart):
    """Return what `grade_and_wet` writes."""
    picture = np.zeros((HEIGHT, WIDTH, 3))
    depth, clearance, film = (np.zeros((HEIGHT, WIDTH)) for _ in range(3))
    for row, column in np.ndindex(HEIGHT, WIDTH):
        at = row, column
        a, b = (column + 0.5 - LENS[2]) / LENS[0], (row + 0.5 - LENS[3]) / LENS[1]
        ray, normal, over = TURN @ F4([a, b, 1]), TURN @ dry["normal"][at], dry["alpha"][at]
        length, up = F4(np.linalg.norm(ray)), normal[2]
        e = dry["plane_depth"][at] * UNIT
        d = e if up > shade.FLAT else dry["depth"][at] * UNIT
        with np.errstate(invalid="ignore"):  # infinite depths
            e = e if abs(e - d) < shade.WALL_SHARE * d else d
            spot = EYE + e * ray
        solid = over >= shade.LEAST_ALPHA
        clear, height, lawn, damp, cover, pores = shade.wet_state(
            dry["bed"], dry["ground"], ORIGIN, SPACING, others, solid, *spot, *normal, e * length
        )
        edge = shade.is_edge(over, look[5])
        color = shade.undiluted(*dry["color"][at], over if edge else F4(1))
        *light, gloss, through = shade.rainy(
            *color, over, d * length, ray[2] / length, -(normal @ ray) / length, up, height, lawn,
            damp, cover, pores, *look,
        )  # fmt: skip
        floor = solid and up > shade.FLAT and height < shade.ON_GROUND
        if apart and floor:
            film[at] = shade.film_cover(
                dry["ground"], ORIGIN, SPACING, *spot[:2], clear, up, lawn, cover
            )
        elif gloss > 0:
            light += gloss * F4(shade.glossed(around, *ray / length))
        if through > shade.LEAST_SKY:
            light += through * F4(sky.sample_environment(day, *ray / length))
        picture[at], depth[at], clearance[at] = light, d if solid else np.inf, clear
    return picture, depth, clearance, film


@pytest.mark.parametrize(("open_sky", "apart"), [(0, False), (1, True)])
def test_chunks_give_what_single_pixels_give(dry, poisoned, open_sky, apart):
    around, day = sky.overcast(0.6), sky.overcast()
    look = F4([0.8, 0.15, 0.9, 0.8, 30, open_sky])
    others = F4([0.9, 0.2, -0.4, 0.8, 0.3])
    shape = HEIGHT, WIDTH
    found = [poisoned(s) for s in ((*shape, 3), shape, shape, shape if apart else (0, 0))]
    grade.grade_and_wet(
        dry["color"], dry["alpha"], dry["depth"], dry["plane_depth"], dry["normal"], UNIT, TURN,
        EYE, LENS, dry["bed"], dry["ground"], ORIGIN, SPACING, around, day, look, others, *found,
    )  # fmt: skip
    wanted = pixel_by_pixel(dry, around, day, look, others, apart)
    for one, other in list(zip(found, wanted, strict=True))[: 4 if apart else 3]:
        np.testing.assert_allclose(one, other, rtol=2e-5, atol=2e-5)
    on_map = wanted[2] < shade.FAR_AWAY
    assert 0.1 < on_map.mean() < 0.9 and np.isinf(wanted[1]).any()
    assert not apart or 0.05 < (wanted[3] > 0).mean() < 0.8


def test_a_chunk_is_interpolated_as_single_places_are(poisoned):
    rng = np.random.default_rng(3)
    field = rng.normal(size=(7, 11)).astype(F4)
    n = chunks.CHUNK - 9
    s = poisoned((2 * chunks.CHUNK,))
    u, v = rng.uniform(-2, 12, n).astype(F4), rng.uniform(-2, 8, n).astype(F4)
    s[:n], s[chunks.CHUNK :][:n] = u, v
    place, corner = np.empty(chunks.CHUNK, np.uint32), poisoned((chunks.CORNERS,))
    chunks.interpolate(field, n, s, 0, chunks.CHUNK, place, corner)
    wanted = [bilinear(field, *at) for at in zip(u, v, strict=True)]
    np.testing.assert_allclose(s[:n], wanted, rtol=1e-5, atol=1e-6)
    assert np.isnan(s[n : chunks.CHUNK]).all()


def test_nowhere_is_some_place_in_memory(poisoned):
    n, field = chunks.CHUNK, np.ones((7, 11), F4)
    s, place, corner = poisoned((3 * n,)), np.empty(n, np.uint32), poisoned((chunks.CORNERS,))
    s[n // 2 : n], s[n + n // 3 : 2 * n] = np.inf, -np.inf
    chunks.nearest(field, n, s, 0, n, 2 * n, place)
    assert (s[2 * n :] == 1).all() and place.max() < field.size
    chunks.interpolate(field, n, s, 0, n, place, corner)
    assert place.max() < field.size - 11
