"""Writers of splat formats for the tests: plain numpy after the formats' descriptions.

They share no code with the readers, so that reading back checks both.
"""

import gzip
import io
import json
import struct
import zipfile
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from made_captures import random_splats

SH_C0 = 0.28209479177387814
LENS = ("PINHOLE", 1, (50.0, 51.0, 31.0, 25.0))  # of COLMAP models


def tame_splats(count, coefficients=4, seed=0):
    """Random splats within the ranges that all formats can store."""
    splats = random_splats(count, coefficients, seed)
    splats.sh[:] = np.clip(splats.sh * 0.3, -0.95, 0.95)
    splats.scale[:] = np.clip(splats.scale, 1e-3, 1)
    return splats


def check_arrays(splats):
    """Arrays are float32, contiguous and hold values that splats may have."""
    n = len(splats)
    shapes = {"position": (3,), "rotation": (4,), "scale": (3,), "opacity": (), "sh": None}
    for name, shape in shapes.items():
        array = getattr(splats, name)
        assert array.dtype == np.float32 and array.flags.c_contiguous, name
        assert np.isfinite(array).all(), name
        assert len(array) == n and (shape is None or array.shape[1:] == shape), name
    assert splats.sh.shape[1] in (1, 4, 9, 16) and splats.sh.shape[2] == 3
    assert (splats.opacity >= 0).all() and (splats.opacity <= 1).all()
    assert (splats.scale >= 0).all() and (np.abs(splats.position) < 1e12).all()
    np.testing.assert_allclose(np.linalg.norm(splats.rotation, axis=1), 1, atol=1e-4)


def to_byte(values):
    """Whole numbers from 0 to 255."""
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def logit(opacity):
    """Inverse of the logistic function."""
    return np.log(opacity / (1 - opacity))


def share(values, bits):
    """Values from 0 to 1 as whole numbers of `bits`."""
    return np.round(np.clip(values, 0, 1) * (2**bits - 1)).astype(np.uint32)


def smallest_three(q):
    """Index of the largest part of each quaternion, made positive, and the others in order."""
    largest = np.abs(q).argmax(axis=1)
    q = q * np.sign(q[np.arange(len(q)), largest])[:, None]
    keep = np.arange(4) != largest[:, None]
    others = q[keep].reshape(-1, 3)
    return largest, others


# --- PLY ------------------------------------------------------------------------------------------


def ply(columns, element="vertex", more=b""):
    """A PLY of one element whose float properties are the dict `columns`."""
    n = len(next(iter(columns.values())))
    lines = ["ply", "format binary_little_endian 1.0", f"element {element} {n}"]
    lines += [f"property float {name}" for name in columns] + ["end_header", ""]
    table = np.stack([np.asarray(c, "<f4") for c in columns.values()], axis=1)
    return "\n".join(lines).encode() + table.tobytes() + more


def stored_columns(splats, normals=True):
    """The properties that the original code writes, in its order."""
    xyz, sh = splats.position, splats.sh
    columns = {name: xyz[:, i] for i, name in enumerate("xyz")}
    if normals:
        columns |= {name: np.zeros(len(xyz)) for name in ("nx", "ny", "nz")}
    columns |= {f"f_dc_{i}": sh[:, 0, i] for i in range(3)}
    rest = sh[:, 1:].transpose(0, 2, 1).reshape(len(xyz), -1)
    columns |= {f"f_rest_{i}": rest[:, i] for i in range(rest.shape[1])}
    columns |= {"opacity": logit(splats.opacity)}
    columns |= {f"scale_{i}": np.log(splats.scale[:, i]) for i in range(splats.scale.shape[1])}
    return columns | {f"rot_{i}": splats.rotation[:, i] for i in range(4)}


def write_splats(path, splats):
    """Write splats as the original code does; opacities of 0 or 1 as the nearest finite logit."""
    opacity = np.clip(splats.opacity.astype(np.float64), 1e-12, 1 - 1e-12)
    scale = np.maximum(splats.scale, np.finfo(np.float32).tiny)
    path.write_bytes(ply(stored_columns(replace(splats, opacity=opacity, scale=scale))))


def compressed_ply(splats, with_colors=True):
    """PlayCanvas compressed PLY; without colour ranges as older programs wrote it."""
    n, log_scale = len(splats), np.log(splats.scale)
    rgb = splats.sh[:, 0] * SH_C0 + 0.5
    ranges, packed = [], []
    for start in range(0, n, 256):
        part = slice(start, start + 256)
        row, shares = [], []
        for values in (splats.position[part], log_scale[part], rgb[part]):
            low, high = values.min(axis=0), values.max(axis=0)
            if values.base is rgb and not with_colors:
                low, high = np.zeros(3), np.ones(3)
            else:
                row += [*low, *high]
            shares.append((values - low) / np.maximum(high - low, 1e-12))
        ranges.append(row)
        packed.append(np.stack([
            _pack_11_10_11(shares[0]),
            _pack_turn(splats.rotation[part]),
            _pack_11_10_11(shares[1]),
            _pack_color(shares[2], splats.opacity[part]),
        ], axis=1))  # fmt: skip
    kinds = ["", "scale_"] + [None] * with_colors
    names = [
        f"{end}_{axis}" if kind is None else f"{end}_{kind}{axis}"
        for kind in kinds
        for end in ("min", "max")
        for axis in ("rgb" if kind is None else "xyz")
    ]
    lines = ["ply", "format binary_little_endian 1.0", f"element chunk {len(ranges)}"]
    lines += [f"property float {name}" for name in names] + [f"element vertex {n}"]
    lines += [f"property uint packed_{q}" for q in ("position", "rotation", "scale", "color")]
    body = np.array(ranges, "<f4").tobytes() + np.concatenate(packed).astype("<u4").tobytes()
    rest = splats.sh[:, 1:].transpose(0, 2, 1).reshape(n, -1)
    if rest.shape[1]:
        lines += [f"element sh {n}"] + [f"property uchar f_rest_{i}" for i in range(rest.shape[1])]
        body += to_byte((rest / 8 + 0.5) * 256 - 0.5).tobytes()
    return "\n".join([*lines, "end_header", ""]).encode() + body


def _pack_11_10_11(shares):
    x, y, z = share(shares[:, 0], 11), share(shares[:, 1], 10), share(shares[:, 2], 11)
    return x << 21 | y << 11 | z


def _pack_turn(q):
    largest, others = smallest_three(q)
    a, b, c = share(others / np.sqrt(2) + 0.5, 10).T
    return largest.astype(np.uint32) << 30 | a << 20 | b << 10 | c


def _pack_color(shares, opacity):
    r, g, b = share(shares, 8).T
    return r << 24 | g << 16 | b << 8 | share(opacity, 8)


# --- records --------------------------------------------------------------------------------------


def splat_records(splats):
    """32-byte records."""
    parts = [
        splats.position.astype("<f4").view(np.uint8),
        splats.scale.astype("<f4").view(np.uint8),
        to_byte((splats.sh[:, 0] * SH_C0 + 0.5) * 255),
        to_byte(splats.opacity * 255)[:, None],
        to_byte(splats.rotation * 128 + 128),
    ]
    return np.concatenate(parts, axis=1).tobytes()


# --- SPZ ------------------------------------------------------------------------------------------


def spz_sections(splats, version, bits=12):
    """The sections of splats that already have SPZ's axes."""
    fixed = np.round(splats.position * 2.0**bits).astype("<i4")
    xyzw = np.roll(splats.rotation, -1, axis=1)
    if version >= 3:
        largest, others = smallest_three(xyzw)
        size = np.round(np.abs(others) * np.sqrt(2) * 511).astype(np.uint32)
        a, b, c = (size | (others < 0).astype(np.uint32) << 9).T
        turn = (largest.astype(np.uint32) << 30 | a << 20 | b << 10 | c).astype("<u4").tobytes()
    else:
        positive = xyzw * np.where(xyzw[:, 3:] < 0, -1, 1)
        turn = to_byte(positive[:, :3] * 127.5 + 127.5).tobytes()
    rest = splats.sh[:, 1:].reshape(len(splats), -1)
    return [
        fixed.view(np.uint8).reshape(-1, 4)[:, :3].tobytes(),
        to_byte(splats.opacity * 255).tobytes(),
        to_byte(splats.sh[:, 0] * 0.15 * 255 + 127.5).tobytes(),
        to_byte((np.log(splats.scale) + 10) * 16).tobytes(),
        turn,
        *([to_byte(rest * 128 + 128).tobytes()] if rest.shape[1] else []),
    ]


def spz_head(splats, version, bits=12, flags=0, streams=0, count=None, degree=None):
    """The 16 bytes that all versions share."""
    degree = round(splats.sh.shape[1] ** 0.5) - 1 if degree is None else degree
    count = len(splats) if count is None else count
    return struct.pack("<IIIBBBB", 0x5053474E, version, count, degree, bits, flags, streams)


def spz(splats, version=3, behind=b"", **head):
    """An SPZ file: gzip, or of version 4 zstd streams; `behind` are the bytes of extensions."""
    sections = spz_sections(splats, min(version, 4))
    if version < 4:
        whole = spz_head(splats, version, **head) + b"".join(sections) + behind
        return gzip.compress(whole, mtime=0)
    import zstandard

    streams = [zstandard.ZstdCompressor().compress(section) for section in sections]
    toc = b"".join(
        struct.pack("<QQ", len(stream), len(section))
        for stream, section in zip(streams, sections, strict=True)
    )
    start = spz_head(splats, 4, streams=len(streams), **head)
    start += struct.pack("<I12x", 32 + len(behind)) + behind
    return start + toc + b"".join(streams)


# --- SOG ------------------------------------------------------------------------------------------


def webp(channels):
    """A lossless WebP whose first pixels are the rows of `channels`, (n, 3 or 4) bytes."""
    from PIL import Image

    n, width = len(channels), 4 * -(-int(np.sqrt(len(channels)) + 1) // 4)
    pixels = np.full((-(-n // width) * width, 4), 255, np.uint8)
    pixels[:n, : channels.shape[1]] = channels
    return webp_image(Image.fromarray(pixels.reshape(-1, width, 4)))


def webp_image(image):
    """A Pillow image as lossless WebP bytes."""
    buffer = io.BytesIO()
    image.save(buffer, "WEBP", lossless=True, exact=True)
    return buffer.getvalue()


def codes(values):
    """A codebook of 256 values and the nearest entry for each of `values`."""
    book = np.linspace(values.min(), values.max(), 256)
    return book.tolist(), np.abs(values[..., None] - book).argmin(axis=-1).astype(np.uint8)


def sog(splats):
    """The files of an unbundled SOG by name."""
    n, bands = splats.sh.shape[:2]
    log = np.sign(splats.position) * np.log1p(np.abs(splats.position))
    low, high = log.min(axis=0), log.max(axis=0)
    place = np.round((log - low) / (high - low) * 65535).astype(np.uint16)
    largest, others = smallest_three(splats.rotation)
    turn = np.column_stack([to_byte((others * np.sqrt(2) + 1) / 2 * 255), largest + 252])
    scale_book, scale = codes(np.log(splats.scale))
    color_book, color = codes(splats.sh[:, 0])
    files = {
        "means_l.webp": webp((place & 255).astype(np.uint8)),
        "means_u.webp": webp((place >> 8).astype(np.uint8)),
        "quats.webp": webp(turn.astype(np.uint8)),
        "scales.webp": webp(scale),
        "sh0.webp": webp(np.column_stack([color, to_byte(splats.opacity * 255)])),
    }
    meta = {
        "version": 2,
        "count": n,
        "means": {
            "mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"],
        },
        "scales": {"codebook": scale_book, "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": color_book, "files": ["sh0.webp"]},
    }  # fmt: skip
    if bands > 1:
        meta["shN"] = _sog_harmonics(splats, files)
    return {"meta.json": json.dumps(meta).encode()} | files


def _sog_harmonics(splats, files):
    """Each splat has a palette entry of its own, entry n - 1 - s for splat s."""
    from PIL import Image

    n, bands = splats.sh.shape[:2]
    book, code = codes(splats.sh[:, 1:])
    rows = -(-n // 64)
    palette = np.full((rows, 64, bands - 1, 4), 255, np.uint8)
    entry = n - 1 - np.arange(n)
    palette[entry // 64, entry % 64, :, :3] = code
    files["shN_centroids.webp"] = webp_image(
        Image.fromarray(palette.reshape(rows, 64 * (bands - 1), 4))
    )
    labels = np.column_stack([entry & 255, entry >> 8, entry * 0])
    files["shN_labels.webp"] = webp(labels.astype(np.uint8))
    degree = round(bands**0.5) - 1
    return {
        "count": n, "bands": degree, "codebook": book,
        "files": ["shN_centroids.webp", "shN_labels.webp"],
    }  # fmt: skip


def sog_v1(splats):
    """The files of a SOG of the first version: linear ranges, no codebooks, no harmonics."""
    files = sog(splats.__class__(*(getattr(splats, n) for n in FIELDS[:-1]), splats.sh[:, :1]))
    meta = json.loads(files["meta.json"])
    del meta["version"], meta["count"]
    meta["means"]["shape"] = [len(splats), 3]
    ranges = {"scales": np.log(splats.scale)}
    ranges["sh0"] = np.column_stack([splats.sh[:, 0], logit(splats.opacity)])
    for name, values in ranges.items():
        low, high = values.min(axis=0), values.max(axis=0)
        files[f"{name}.webp"] = webp(to_byte((values - low) / (high - low) * 255))
        meta[name] = {"mins": low.tolist(), "maxs": high.tolist(), "files": [f"{name}.webp"]}
    return files | {"meta.json": json.dumps(meta).encode()}


FIELDS = ("position", "rotation", "scale", "opacity", "sh")


def usda_splats(splats, half="", lines="", **changed):
    """A prim of splats as text, after UsdVol's schema; `changed` attributes are text or None."""

    def rows(values):
        values = [", ".join(f"{v:.9g}" for v in row) for row in values.reshape(len(values), -1)]
        return "[" + ", ".join(f"({v})" if "," in v else v for v in values) + "]"

    harmonics, real = "radiance:sphericalHarmonics", "half" if half else "float"
    attributes = {
        f"uniform int {harmonics}Degree": round(splats.sh.shape[1] ** 0.5) - 1,
        f"point3{real[0]}[] positions{half}": rows(splats.position),
        f"quat{real[0]}[] orientations{half}": rows(splats.rotation),
        f"{real}3[] scales{half}": rows(splats.scale),
        f"{real}[] opacities{half}": rows(splats.opacity),
        f"{real}3[] {harmonics}Coefficients{half}": rows(splats.sh.reshape(-1, 3)),
    }
    attributes = "\n".join(
        changed.get(name.rpartition(":")[2].rpartition(" ")[2], f"{name} = {value}")
        for name, value in attributes.items()
    )
    return f'def ParticleField3DGaussianSplat "Splats"\n{{\n{attributes}\n{lines}\n}}\n'


def bundle(files, compression=zipfile.ZIP_STORED, prefix=""):
    """Files by name as a zip."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, data in files.items():
            archive.writestr(prefix + name, data)
    return buffer.getvalue()


def write_folder(folder, files):
    """Write files by name into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder


# --- COLMAP ---------------------------------------------------------------------------------------


def _pose(camera):
    """Quaternion, w first, and translation of an image as COLMAP stores them."""
    x, y, z, w = Rotation.from_matrix(camera.camera_from_world[:3, :3]).as_quat()
    return (w, x, y, z), tuple(camera.camera_from_world[:3, 3])


def colmap_binary(folder, cameras, lens=LENS, points=3):
    """Write cameras.bin and images.bin of cameras that share one lens."""
    _, model, values = lens
    folder.mkdir(parents=True, exist_ok=True)
    size = (cameras[0].width, cameras[0].height)
    lenses = struct.pack("<Q", 1) + struct.pack("<IiQQ", 7, model, *size)
    (folder / "cameras.bin").write_bytes(lenses + struct.pack(f"<{len(values)}d", *values))
    images = struct.pack("<Q", len(cameras))
    for i, camera in enumerate(cameras):
        turn, shift = _pose(camera)
        images += struct.pack("<I7dI", i + 1, *turn, *shift, 7) + f"{camera.name}.JPG".encode()
        images += b"\0" + struct.pack("<Q", points) + points * struct.pack("<ddq", 1, 2, -1)
    (folder / "images.bin").write_bytes(images)


def colmap_text(folder, cameras, lens=LENS, points=1):
    """Write cameras.txt and images.txt of cameras that share one lens."""
    model, _, values = lens
    folder.mkdir(parents=True, exist_ok=True)
    numbers = " ".join(map(repr, values))
    size = f"{cameras[0].width} {cameras[0].height}"
    (folder / "cameras.txt").write_text(f"# cameras\n7 {model} {size} {numbers}\n")
    lines = ["# images", "# two lines each"]
    for i, camera in enumerate(cameras):
        turn, shift = _pose(camera)
        numbers = " ".join(repr(float(v)) for v in (*turn, *shift))
        lines += [f"{i + 1} {numbers} 7 {camera.name}.JPG", "1.5 2.5 -1 " * points]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")


# --- glTF -----------------------------------------------------------------------------------------


GLTF = "KHR_gaussian_splatting"
GLTF_TYPES = {"f4": 5126, "i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123}


def glb(splats, nodes=None, types=(), about=(), more=()):
    """A binary glTF of one mesh of splats; positions, turns and colours are stored as they stand.

    `nodes` place the mesh, `types` maps attributes to numpy types that are stored normalized,
    `about` is added to the extension's object and `more` to the JSON.
    """
    columns = {"POSITION": splats.position, "ROTATION": np.roll(splats.rotation, -1, axis=1)}
    columns |= {"SCALE": splats.scale, "OPACITY": splats.opacity[:, None]}
    for k in range(splats.sh.shape[1]):
        degree = int(np.sqrt(k))
        columns[f"SH_DEGREE_{degree}_COEF_{k - degree * degree}"] = splats.sh[:, k]
    attributes, views, accessors, binary = {}, [], [], b""
    for name, column in columns.items():
        kind = dict(types).get(name, "f4")
        if kind != "f4":
            column = np.round(column * np.iinfo(kind).max)
        data = np.ascontiguousarray(column, "<" + kind).tobytes()
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
        binary += data + bytes(-len(data) % 4)
        accessors.append({
            "bufferView": len(accessors), "componentType": GLTF_TYPES[kind], "count": len(splats),
            "type": {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[column.shape[1]],
        } | ({} if kind == "f4" else {"normalized": True}))  # fmt: skip
        attributes[name if name == "POSITION" else f"{GLTF}:{name}"] = len(accessors) - 1
    extension = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"} | dict(about)
    primitive = {"attributes": attributes, "mode": 0, "extensions": {GLTF: extension}}
    tree = {
        "asset": {"version": "2.0"}, "extensionsUsed": [GLTF], "scene": 0,
        "scenes": [{"nodes": [0]}], "nodes": nodes or [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}], "accessors": accessors, "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    } | dict(more)  # fmt: skip
    return glb_of(tree, binary)


def glb_of(tree, binary):
    """A binary glTF of a JSON object and its binary chunk."""
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(binary)
    head = struct.pack("<4sII", b"glTF", 2, size) + struct.pack("<I4s", len(text), b"JSON")
    return head + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
