"""Writes splats as unbundled SOG, version 2: lossless WebP pictures and a meta.json.

Positions are kept in 16 bits of their logarithm over the chunk's range, turns in three bytes,
scales and colours as entries of a codebook of 256 numbers, opacity in 8 bits, and harmonics above
degree 0 as entries of a palette. The palette is found by splitting: the set of harmonics is cut in
two at the mean along the direction in which it spreads most, again and again.
"""

import json
import math

import numpy as np

from rainsim.io.images import lossless_webp
from rainsim.scene.formats.sog import CODES, META, PALETTE_LIMIT, PALETTE_ROW

FAINTEST = 1e-30  # a scale of 0 has no logarithm
ROUNDS = 12  # of moving the numbers of a codebook
SHARE = 6  # splats for an entry of the palette
DIRECTIONS = 12  # principal ones of the harmonics that splits go along


def write_sog(folder, splats, antialiased=False):
    """Write splats into a folder, in their order.

    splats : Splats. At least one, all of them usable.

    Two sets of the same splats have the same bytes. Opacities below 1/510 come back as 0.
    """
    folder.mkdir(parents=True, exist_ok=True)
    position = splats.position.astype(np.float64)
    log = np.sign(position) * np.log1p(np.abs(position))
    low, high = log.min(axis=0), log.max(axis=0)
    place = np.rint((log - low) / np.where(high > low, high - low, 1) * 65535).astype(np.uint16)
    scales, scale_codes = _codebook(np.log(np.maximum(splats.scale, FAINTEST)))
    colors, color_codes = _codebook(splats.sh[:, 0])
    opacity = np.rint(np.clip(splats.opacity, 0, 1) * 255).astype(np.uint8)
    pictures = {
        "means_l.webp": (place & 255).astype(np.uint8),
        "means_u.webp": (place >> 8).astype(np.uint8),
        "quats.webp": _turns(splats.rotation),
        "scales.webp": scale_codes,
        "sh0.webp": np.column_stack([color_codes, opacity]),
    }
    meta = {
        "version": 2, "count": len(splats),
        "means": {
            "mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"],
        },
        "scales": {"codebook": scales, "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": colors, "files": ["sh0.webp"]},
    }  # fmt: skip
    if antialiased:
        meta["model"] = "antialiased"
    if splats.sh.shape[1] > 1:
        meta["shN"], palette, pictures["shN_labels.webp"] = _harmonics(splats.sh[:, 1:])
        (folder / "shN_centroids.webp").write_bytes(lossless_webp(palette))
    width = 4 * math.ceil(math.sqrt(len(splats)) / 4)
    for name, values in pictures.items():
        pixels = np.full((-(-len(splats) // width) * width, 4), 255, np.uint8)
        pixels[: len(values), : values.shape[1]] = values
        (folder / name).write_bytes(lossless_webp(pixels.reshape(-1, width, 4)))
    (folder / META).write_text(json.dumps(meta), encoding="utf-8")


def _turns(rotation):
    """Return quaternions as three smaller parts and the largest one's place, as 252 to 255."""
    rows = np.arange(len(rotation))
    largest = np.abs(rotation).argmax(axis=1)
    signed = rotation * np.where(rotation[rows, largest] < 0, -1, 1)[:, None]
    keep = np.arange(4) != largest[:, None]
    small = signed[keep].reshape(-1, 3) * math.sqrt(2)
    codes = np.rint((np.clip(small, -1, 1) + 1) / 2 * 255)
    return np.column_stack([codes, largest + 252]).astype(np.uint8)


def _codebook(values):
    """Return CODES rising numbers near the values, and the number of the nearest for each value.

    Lloyd's method in one dimension, from quantiles on.
    """
    ordered = np.sort(values.ravel().astype(np.float64))
    book = np.quantile(ordered, (np.arange(CODES) + 0.5) / CODES)
    even = np.linspace(ordered[0], ordered[-1], CODES)
    book = np.sort(np.concatenate([book[::2], even[1::2]]))  # rare values have codes near them too
    total = np.concatenate([[0.0], np.cumsum(ordered)])
    for _ in range(ROUNDS):
        cut = np.searchsorted(ordered, (book[1:] + book[:-1]) / 2)
        first, last = np.concatenate([[0], cut]), np.concatenate([cut, [len(ordered)]])
        count = last - first
        book = np.where(count > 0, (total[last] - total[first]) / np.maximum(count, 1), book)
    book = book.astype(np.float32)
    codes = np.searchsorted((book[1:] + book[:-1]) / 2, values)
    return [float(v) for v in book], codes.astype(np.uint8)


def _harmonics(sh):
    """Return meta.json's entry on harmonics (n, k, 3), their palette picture and their labels."""
    n, bands = sh.shape[:2]
    label, entries = _palette(sh.reshape(n, -1), min(PALETTE_LIMIT, max(64, n // SHARE)))
    book, codes = _codebook(entries)
    rows = -(-len(entries) // PALETTE_ROW)
    palette = np.full((rows * PALETTE_ROW, bands, 4), 255, np.uint8)
    palette[: len(entries), :, :3] = codes.reshape(-1, bands, 3)
    facts = {
        "count": len(entries), "bands": math.isqrt(bands + 1) - 1, "codebook": book,
        "files": ["shN_centroids.webp", "shN_labels.webp"],
    }  # fmt: skip
    labels = np.column_stack([label & 255, label >> 8]).astype(np.uint8)
    return facts, palette.reshape(rows, PALETTE_ROW * bands, 4), np.ascontiguousarray(labels)


def _palette(values, most):
    """Return the number of the entry of each row of values (n, k), and at most `most` entries."""
    n, width = values.shape
    away = values - values.mean(axis=0)
    axes = np.linalg.eigh(away.T.astype(np.float64) @ away)[1][:, ::-1][:, :DIRECTIONS]
    along = np.ascontiguousarray((away @ axes.astype(np.float32)).T.astype(np.float64))
    label = np.zeros(n, np.int64)
    for _ in range(max(0, int(math.log2(min(most, n))))):
        groups = int(label.max()) + 1
        count = np.maximum(np.bincount(label, minlength=groups), 1)
        mean = np.stack([np.bincount(label, row, groups) / count for row in along])
        spread = np.stack([np.bincount(label, row * row, groups) for row in along])
        widest = (spread / count - mean**2).argmax(axis=0)
        upper = along[widest[label], np.arange(n)] > mean[widest[label], label]
        label = np.unique(2 * label + upper, return_inverse=True)[1]
    count = np.bincount(label)
    entries = np.stack([np.bincount(label, values[:, k]) / count for k in range(width)], -1)
    return label, entries
