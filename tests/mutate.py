"""Seeded damage to files, for tests that readers survive it."""

import gzip
import json
import struct
import zipfile

import made_formats as made

EDGES = (0, 1, 2, 0x7F, 0x80, 0xFF, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
WORDS = (
    b"0", b"-1", b"1e999", b"nan", b"999999999999", b"18446744073709551616", b"null", b"[]", b"{}",
    b'"', b"\\u0000", b"../", b"element vertex 7\n", b"property float x\n", b"list uchar int q",
    b"end_header\n", b"double", b"uchar", b"true", b"1.5", b"\n", b"\0",
)  # fmt: skip
PLY_KEYS = (b"float", b"uint", b"uchar", b"element", b"property", b"vertex", b"chunk", b"rot_0")


def mutated(rng, data):
    """`data` with one to six random changes."""
    data = bytearray(data)
    for _ in range(rng.integers(1, 7)):
        change = CHANGES[rng.integers(len(CHANGES))]
        # Headers decide most: half of the changes go to the first bytes.
        reach = len(data) if rng.random() < 0.5 else min(len(data), 400)
        place = int(rng.integers(reach)) if reach else 0
        data = change(rng, data, place)
    return bytes(data)


def _flip(rng, data, place):
    if data:
        data[place] ^= 1 << int(rng.integers(8))
    return data


def _byte(rng, data, place):
    if data:
        data[place] = int(rng.integers(256))
    return data


def _edge(rng, data, place):
    form = "<" + "BHIQ"[rng.integers(4)]
    size = struct.calcsize(form)
    value = EDGES[rng.integers(len(EDGES))] & (1 << 8 * size) - 1
    data[place : place + size] = struct.pack(form, value)
    return data


def _cut(rng, data, place):
    return data[:place]


def _drop(rng, data, place):
    del data[place : place + int(rng.integers(1, 64))]
    return data


def _repeat(rng, data, place):
    piece = data[place : place + int(rng.integers(1, 64))]
    data[place:place] = piece
    return data


def _word(rng, data, place):
    data[place:place] = WORDS[rng.integers(len(WORDS))]
    return data


def _number(rng, data, place):
    """Replace a run of digits."""
    start = next((i for i in range(place, len(data)) if 48 <= data[i] < 58), None)
    if start is None:
        return data
    end = start
    while end < len(data) and 48 <= data[end] < 58:
        end += 1
    data[start:end] = WORDS[rng.integers(6)]
    return data


def _key(rng, data, place):
    """Replace a word of a PLY header by another."""
    key, other = (PLY_KEYS[i] for i in rng.integers(len(PLY_KEYS), size=2))
    return data.replace(key, other, 1)


def _noise(rng, data, place):
    size = int(rng.integers(1, 256))
    data[place : place + size] = rng.bytes(size)
    return data


CHANGES = (_flip, _byte, _edge, _cut, _drop, _repeat, _word, _number, _key, _noise)


# --- kinds of files: damage at the surface, and inside an intact wrapping -------------------------


def plain(rng, data):
    """Bytes as they are."""
    return mutated(rng, data)


def zipped(rng, data):
    """Within gzip, half of the time."""
    if rng.random() < 0.5:
        return mutated(rng, data)
    return gzip.compress(mutated(rng, gzip.decompress(data)), compresslevel=1, mtime=0)


def bundled(rng, files):
    """One file of a bundle, or the bundle itself."""
    return _zip_of(rng, files) if rng.random() < 0.7 else mutated(rng, made.bundle(files))


def _zip_of(rng, files):
    compression = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)[rng.integers(2)]
    return made.bundle(one_mutated(rng, files), compression)


def one_mutated(rng, files):
    """Files by name, one of them damaged; meta.json half of the time."""
    names = list(files)
    name = "meta.json" if rng.random() < 0.5 else names[rng.integers(len(names))]
    return files | {name: mutated(rng, files[name])}


# --- JSON: values in place of others --------------------------------------------------------------

DEEP = "[" * 60 + "]" * 60
VALUES = (
    "null", "true", "[]", "{}", '""', '"\\u001b[31m"', "0", "-1", "1e308", "NaN", "Infinity",
    "1" * 400, "9" * 5000, "[" * 100_000, DEEP, '"' + "a" * 10_000 + '"', "[[1,2],[3]]", "0.5",
)  # fmt: skip


def valued(rng, text):
    """JSON text with a value replaced by another, or its bytes damaged."""
    if rng.random() < 0.3:
        return mutated(rng, text)
    data = json.loads(text)
    places = list(_places(data))
    holder, key = places[rng.integers(len(places))]
    if rng.random() < 0.2:
        holder.pop(key)
        return json.dumps(data).encode()
    holder[key] = "@here@"
    return json.dumps(data).replace('"@here@"', VALUES[rng.integers(len(VALUES))]).encode()


def _places(data):
    """Yield (dict or list, key) of every value in nested data."""
    for key in list(data) if isinstance(data, dict) else range(len(data)):
        yield data, key
        if isinstance(data[key], dict | list):
            yield from _places(data[key])
