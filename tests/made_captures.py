"""Small captures for the tests of readers and the ground frame, made with numpy alone."""

import json

import numpy as np

from rainsim.scene.cameras import look_at
from rainsim.scene.types import Splats


def splats_at(points, coefficients=1, scale=0.02, opacity=0.9):
    """Round splats at `points` of shape (n, 3)."""
    n = len(points)
    return Splats(
        position=np.ascontiguousarray(points, np.float32),
        rotation=np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        scale=np.full((n, 3), scale, np.float32),
        opacity=np.full(n, opacity, np.float32),
        sh=np.zeros((n, coefficients, 3), np.float32),
    )


def random_splats(count, coefficients=4, seed=0):
    """Splats with all values random and valid."""
    rng = np.random.default_rng(seed)
    turn = rng.normal(size=(count, 4))
    return Splats(
        position=rng.normal(size=(count, 3)).astype(np.float32),
        rotation=(turn / np.linalg.norm(turn, axis=1, keepdims=True)).astype(np.float32),
        scale=np.exp(rng.normal(-3, 1, size=(count, 3))).astype(np.float32),
        opacity=rng.uniform(0.01, 0.99, size=count).astype(np.float32),
        sh=rng.normal(size=(count, coefficients, 3)).astype(np.float32),
    )


def leaves(count, deviation, far, coefficients, seed=3):
    """Fine flat leaves, scattered from 3 to `far` before a wall that is one large splat."""
    rng = np.random.default_rng(seed)
    rotation = rng.normal(size=(count, 4)).astype(np.float32)
    scale = np.full((count, 3), deviation, np.float32)
    scale[:, 2] = 1e-3
    position = rng.uniform((-1, -1, 3), (1, 1, far), (count, 3)).astype(np.float32)
    position[0], scale[0] = (0, 0, far + 2), (3, 3, 0.01)
    rotation[0] = (1, 0, 0, 0)
    color = rng.uniform(-1, 1, (count, coefficients, 3)).astype(np.float32)
    color[:, 1:] *= 0.1
    opacity = rng.uniform(0.1, 0.9, count).astype(np.float32)
    return Splats(position, rotation, scale, opacity, color)


def ring(radius=3.0, height=1.5, count=12):
    """Cameras on a circle that look at a point half a unit above the origin; z is up."""
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    eyes = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), angles * 0 + height])
    return [
        look_at(eye, (0, 0, 0.5), (0, 0, 1), 60, 64, 48, f"ring{i:02d}")
        for i, eye in enumerate(eyes)
    ]


def patio(count=6000, seed=0):
    """Points of paving within 1.5 of the origin, a lawn 0.06 higher about it, a table top."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform(-5, 5, (count, 2))
    paved = np.hypot(*ground.T) < 1.5
    height = np.where(paved, 0, 0.06) + rng.normal(size=count) * np.where(paved, 0.002, 0.01)
    table = rng.uniform(-0.5, 0.5, (count // 6, 2))
    return np.concatenate([
        np.column_stack([ground, height]),
        np.column_stack([table, np.full(len(table), 0.75)]),
    ])  # fmt: skip


def capture_cameras(cameras):
    """What `cameras.json` of the original code holds."""
    return [
        {
            "id": number, "img_name": camera.name, "width": camera.width, "height": camera.height,
            "position": camera.position.tolist(), "fx": camera.fx, "fy": camera.fy,
            "rotation": camera.camera_from_world[:3, :3].T.tolist(),
        }
        for number, camera in enumerate(cameras)
    ]  # fmt: skip


def write_model_folder(folder, scene, names):
    """Write a scene as a trained model's folder, as codes that train captures leave it.

    Parameters
    ----------
    folder : Path
    scene : Scene
    names : sequence of str
        Of the cameras, in place of the scene's own.
    """
    from made_formats import ply, stored_columns

    model = folder / "point_cloud" / "iteration_30000"
    model.mkdir(parents=True)
    (model / "point_cloud.ply").write_bytes(ply(stored_columns(scene.splats)))
    cameras = capture_cameras(scene.cameras)
    for camera, name in zip(cameras, names, strict=True):
        camera["img_name"] = name
    (folder / "cameras.json").write_text(json.dumps(cameras), encoding="utf-8")
