"""Effect of rain on splats that are trained in it: PSNR and SSIM of clear views against mm/h.

Trains the same splats (same points, seed and steps) on a data set's clear pictures and on those of
each rain, on all pixels and with those left out of the loss that drops or also puddles spoil, and
compares with held-out clear views, or with held-out views in clear air in the light of the rain,
which parts what falls from light and wet ground. Needs torch; on a GPU gsplat draws, without one a
plain renderer that suits only tiny pictures. `examples/downstream.py` exports the data set and
calls `measure`.
"""

from __future__ import annotations

import math
from importlib.util import find_spec

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.stored_views import read_points, read_views
from benchmarks.suite import intrinsics
from rainsim.constants import SH_0
from rainsim.datasets.reading import stored_card
from rainsim.errors import ParameterError
from rainsim.io.files import write_json
from rainsim.io.images import write_png
from rainsim.scene.view import image_point

try:
    import torch
except ImportError:  # an extra: `measure` says so
    torch = None

# Learning rates of 3DGS (Kerbl et al. 2023); places move less and less, per metre of the scene.
RATES_OF = {"scale": 5e-3, "turn": 1e-3, "opacity": 5e-2, "color": 2.5e-3}
FIRST_MOVE, LAST_MOVE = 1.6e-4, 1.6e-6
DSSIM = 0.2  # share of 1 - SSIM in the loss
FIRST_OPACITY = 0.1
NEIGHBOURS = 3  # whose mean distance is a splat's first size
MASKS = ("nothing", "drops", "drops, water")  # what is left out of the loss
WHAT_FALLS = "what falls"  # is not in the pictures: the rain's partners in clear air
CLEAR, CLEAR_AIR = AGAINST = "clear", "clear_air"  # held-out pictures that splats are judged by
ACROSS = 4  # pictures of a row of downstream.png
RIM = 5  # px, half the window of SSIM
NEAR, LOW_PASS, LEAST_ALPHA, MOST_ALPHA = 0.05, 0.3, 1 / 255, 0.999


class Splats:
    """Trainable splats: places [m], logarithms of sizes, quaternions, logits, harmonics."""

    def __init__(self, places, colors, degree, device):
        tree = cKDTree(places)
        apart = tree.query(places, NEIGHBOURS + 1)[0][:, 1:].mean(axis=1)
        sh = np.zeros((len(places), (degree + 1) ** 2, 3), np.float32)
        sh[:, 0] = (colors / 255 - 0.5) / SH_0
        turn = np.zeros((len(places), 4), np.float32)
        turn[:, 0] = 1
        logit = math.log(FIRST_OPACITY / (1 - FIRST_OPACITY))
        first = {
            "place": places, "scale": np.log(np.maximum(apart, 1e-4))[:, None].repeat(3, axis=1),
            "turn": turn, "opacity": np.full(len(places), logit), "color": sh[:, :1],
            "fine": sh[:, 1:],
        }  # fmt: skip
        self.values = {
            name: torch.tensor(a, dtype=torch.float32, device=device, requires_grad=True)
            for name, a in first.items()
        }
        self.degree = degree

    def optimizer(self, extent):
        """Return Adam with a group for each kind of value; the first group moves places."""
        rates = {"place": FIRST_MOVE * extent, "fine": RATES_OF["color"] / 20, **RATES_OF}
        groups = [{"params": [v], "lr": rates[k]} for k, v in self.values.items() if v.numel()]
        return torch.optim.Adam(groups, eps=1e-15)

    def picture(self, camera):
        """Return the picture of a camera (ground frame, metres) over black, (height, width, 3)."""
        v = self.values
        sh = torch.cat([v["color"], v["fine"]], dim=1)
        view = torch.tensor(camera.camera_from_world, dtype=torch.float32, device=sh.device)
        if sh.is_cuda:
            from gsplat import rasterization

            lens = torch.tensor(intrinsics(camera), dtype=torch.float32, device=sh.device)
            drawn = rasterization(
                v["place"], v["turn"], v["scale"].exp(), v["opacity"].sigmoid(), sh, view[None],
                lens[None], camera.width, camera.height, near_plane=NEAR, sh_degree=self.degree,
                packed=False,
            )  # fmt: skip
            return drawn[0][0]
        if self.degree:
            raise ParameterError(
                f"degree is {self.degree}; without a GPU it must be 0: the plain renderer draws no "
                "other; give degree=0"
            )
        color = (SH_0 * v["color"][:, 0] + 0.5).clamp(min=0)
        return plain(v["place"], v["turn"], v["scale"].exp(), v["opacity"].sigmoid(), color,
                     view, camera)  # fmt: skip


def plain(place, turn, scale, opacity, color, view, camera):
    """Return a picture by the same rules as gsplat and rainsim.raster, each pixel by all splats."""
    point = place @ view[:3, :3].T + view[:3, 3]
    order = torch.argsort(point[:, 2].detach())
    order = order[point[order, 2] > NEAR]
    x, y, z = point[order].T
    w, i, j, k = torch.nn.functional.normalize(turn[order], dim=1).T
    axes = torch.stack([
        1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j),
        2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i),
        2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j),
    ], dim=1).view(-1, 3, 3)  # fmt: skip
    half = axes * scale[order][:, None]
    zero = torch.zeros_like(z)
    # The projection is linearised at most 15 % of the picture beyond its rim, as in the original.
    lx, ly = (
        (a / z).clamp((-c - 0.15 * n) / f, (n - c + 0.15 * n) / f)
        for a, c, n, f in ((x, camera.cx, camera.width, camera.fx),
                           (y, camera.cy, camera.height, camera.fy))
    )  # fmt: skip
    lines = torch.stack([camera.fx / z, zero, -camera.fx * lx / z,
                         zero, camera.fy / z, -camera.fy * ly / z], dim=1)  # fmt: skip
    flat = lines.view(-1, 2, 3) @ view[:3, :3] @ half
    spread = flat @ flat.transpose(1, 2) + LOW_PASS * torch.eye(2, device=place.device)
    conic = torch.linalg.inv(spread)
    u, v = image_point(camera, x, y, z)
    columns = torch.arange(camera.width, device=place.device) + 0.5
    rows = []
    for row in range(camera.height):
        dx, dy = columns[:, None] - u, row + 0.5 - v
        power = conic[:, 0, 0] * dx * dx + 2 * conic[:, 0, 1] * dx * dy + conic[:, 1, 1] * dy * dy
        alpha = (opacity[order] * torch.exp(-0.5 * power)).clamp(max=MOST_ALPHA)
        alpha = torch.where(alpha < LEAST_ALPHA, 0, alpha)
        through = torch.cumprod(torch.cat([torch.ones_like(alpha[:, :1]), 1 - alpha], 1), 1)
        rows.append((alpha * through[:, :-1]) @ color[order])
    return torch.stack(rows)


def ssim(a, b):
    """Return SSIM (Wang et al. 2004) of pictures (height, width, 3) around each pixel.

    The window is Gaussian with sigma 1.5 px, cut at 11 px. The result lacks RIM pixels on each
    side.
    """
    t = torch.arange(-RIM, RIM + 1, dtype=torch.float32, device=a.device)
    line = torch.exp(-(t**2) / (2 * 1.5**2))
    line = (line / line.sum()).repeat(3, 1)[:, None]

    def mean(picture):
        across = torch.nn.functional.conv2d(picture, line[:, :, None], groups=3)
        return torch.nn.functional.conv2d(across, line[..., None], groups=3)

    a, b = (p.permute(2, 0, 1)[None] for p in (a, b))
    ma, mb = mean(a), mean(b)
    va, vb, both = mean(a * a) - ma**2, mean(b * b) - mb**2, mean(a * b) - ma * mb
    c1, c2 = 0.01**2, 0.03**2
    found = ((2 * ma * mb + c1) * (2 * both + c2)) / ((ma**2 + mb**2 + c1) * (va + vb + c2))
    return found[0].permute(1, 2, 0)


def masks_of(folder, views, left_out):
    """Return which pixels of views count in the loss, (height, width) of bool each."""
    if left_out == "nothing":
        return [np.ones_like(view.keep) for view in views]
    named = stored_card(folder)["classes"].items()
    water = [int(number) for number, name in named if name == "water"]
    spared = water if left_out == "drops" else []
    return [view.keep | np.isin(view.class_id, spared) for view in views]


def train(views, points, masks, seed, steps, degree, device):
    """Return splats trained on views; pixels outside the masks count as they are drawn."""
    torch.manual_seed(seed)
    splats = Splats(*points, degree, device)
    eyes = np.array([view.camera.position for view in views])
    adam = splats.optimizer(1.1 * np.linalg.norm(eyes - eyes.mean(axis=0), axis=1).max())
    start = adam.param_groups[0]["lr"]
    truth = [torch.tensor(v.picture, device=device).float() / 255 for v in views]
    keep = [torch.tensor(mask, device=device)[..., None] for mask in masks]
    rng = np.random.default_rng(seed)
    for step in range(steps):
        if step % len(views) == 0:
            order = rng.permutation(len(views))
        n = order[step % len(views)]
        adam.param_groups[0]["lr"] = start * (LAST_MOVE / FIRST_MOVE) ** (step / steps)
        drawn = splats.picture(views[n].camera)
        wanted = torch.where(keep[n], truth[n], drawn.detach())
        loss = (1 - DSSIM) * (drawn - wanted).abs().mean()
        unlike = (1 - ssim(drawn, wanted)) * keep[n][RIM:-RIM, RIM:-RIM]
        loss = loss + DSSIM * unlike.mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
    return splats


def psnr(a, b):
    """Return the peak signal-to-noise ratio [dB] of pictures with values from 0 to 1."""
    return float(-10 * np.log10(np.mean((a - b) ** 2)))


def tint_fitted(a, b):
    """Return picture `a` with the affine map of its colours that comes nearest to `b`."""
    flat = np.column_stack([a.reshape(-1, 3), np.ones(a.size // 3)])
    fit = np.linalg.lstsq(flat, b.reshape(-1, 3), rcond=None)[0]
    return np.clip(flat @ fit, 0, 1).reshape(a.shape)


def judge(splats, views):
    """Return mean PSNR, SSIM and PSNR with fitted tint over views, and the pictures."""
    rows, pictures = [], []
    for view in views:
        with torch.no_grad():
            drawn = splats.picture(view.camera).clamp(0, 1)
        truth = torch.tensor(view.picture, device=drawn.device).float() / 255
        same = float(ssim(drawn, truth).mean())
        a, b = drawn.cpu().numpy().astype(float), view.picture / 255
        rows.append((psnr(a, b), same, psnr(tint_fitted(a, b), b)))
        pictures.append(np.rint(a * 255).astype(np.uint8))
    return np.mean(rows, axis=0), pictures


def measure(folder, out, rates=None, steps=3000, most=50_000, seed=0, degree=1, against=CLEAR,
            say=print):  # fmt: skip
    """Train on each rain of a data set, judge by its held-out views, and return the rows.

    Parameters
    ----------
    folder : path-like
        A finished data set in nerfstudio's layout, see `benchmarks.stored_views`, with held-out
        views, and with clear pictures or partners.
    out : Path
        Where table.json and downstream.png go: the first held-out view and what is trained for it.
    rates : sequence of float [mm/h], optional
        By default all that the data set has.
    steps : int
    most : int
        Splats, at most: so many of the data set's points are drawn by the seed.
    seed : int
    degree : int
        Of the colours' harmonics; without a GPU it must be 0.
    against : {"clear", "clear_air"}
        Judge by the clear pictures, or by each rain's partners `clear_air`: those have its light
        and its wet ground, so that what is lost is lost by what falls alone. Then each rain has a
        row that is trained on its partners, and 0 mm/h has none.
    say : callable
        Called with each line of the table.

    Returns
    -------
    list of dict

    Raises
    ------
    ParameterError
        If torch is not installed, or on a GPU gsplat, no view is held out, or partners are missing.
    """
    if against not in AGAINST:
        raise ParameterError(f"against is {against!r}; it must be one of {', '.join(AGAINST)}")
    card = stored_card(folder)
    rates = [r["rain_mm_per_hour"] for r in card["rains"]] if rates is None else rates
    if against == CLEAR_AIR and not any(rates):
        raise ParameterError(f"{folder} has no rain; partners are of rainy pictures; export more")
    places, colors = read_points(folder)
    some = np.random.default_rng(seed).permutation(len(places))[:most]
    points, table, sheet = (places[some], colors[some]), [], []
    truth = clear = _held_out(folder, read_views(folder, 0)) if against == CLEAR else None
    device = _device()
    say("mm/h  left out of the loss   PSNR   SSIM   PSNR with fitted tint")
    for rate in rates:
        if against == CLEAR_AIR and rate == 0:
            continue
        views = read_views(folder, rate)
        trained = [(views, name) for name in (MASKS if rate else MASKS[:1])]
        if against == CLEAR_AIR:
            partners = read_views(folder, rate, CLEAR_AIR)
            truth = _held_out(folder, partners)
            trained.insert(0, (partners, WHAT_FALLS))
        if clear is None or not sheet:
            sheet.append(truth[0].picture)
        for source, left_out in trained:
            given = [view for view in source if not view.held_out]
            masks = masks_of(folder, given, MASKS[0] if left_out == WHAT_FALLS else left_out)
            share = 1 - float(np.mean([mask.mean() for mask in masks]))
            splats = train(given, points, masks, seed, steps, degree, device)
            (db, same, fitted), pictures = judge(splats, truth)
            say(f"{rate:4g}  {left_out:12} ({share:5.1%})   {db:5.2f}  {same:.3f}  {fitted:5.2f}")
            table.append({"mm_per_hour": rate, "left_out": left_out, "share": share, "psnr": db,
                          "ssim": same, "psnr_fitted_tint": fitted})  # fmt: skip
            sheet.append(pictures[0])
    facts = {"scene": card["scene"], "views": len(card["views"]), "held_out": len(truth),
             "width": card["width"], "steps": steps, "splats": len(some), "seed": seed,
             "degree": degree, "device": device, "against": against, "rows": table}  # fmt: skip
    write_json(out / "table.json", facts)
    sheet += [np.zeros_like(sheet[0])] * (-len(sheet) % ACROSS)
    rows = [np.concatenate(sheet[k : k + ACROSS], axis=1) for k in range(0, len(sheet), ACROSS)]
    write_png(out / "downstream.png", np.concatenate(rows))
    return table


def _held_out(folder, views):
    found = [view for view in views if view.held_out]
    if not found:
        raise ParameterError(
            f"{folder} holds out none of its {len(views)} views; it must hold out one or more to "
            "judge by; export it again with more --views or another --hold-out"
        )
    return found


def _device():
    """Return where to train, "cuda" or "cpu"; raise ParameterError for a missing library."""
    remedy = 'pip install "rainsim[downstream]"'
    if torch is None:
        raise ParameterError(f"training needs torch, which is not installed; {remedy}")
    if torch.cuda.is_available() and find_spec("gsplat") is None:
        raise ParameterError(f"a GPU is drawn on by gsplat, which is not installed; {remedy}")
    return "cuda" if torch.cuda.is_available() else "cpu"
