"""Slow, plain references in float64, with no code of the kernels, and how alike pictures are."""

import numpy as np


def quaternion_matrix(q):
    """Rotation matrix of a unit quaternion, w first."""
    w, x, y, z = np.asarray(q, float) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def sh_basis(direction, bands):
    """Real spherical harmonics of the original 3DGS code in a unit direction."""
    x, y, z = direction
    basis = [0.28209479177387814]
    if bands > 1:
        basis += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    if bands > 2:
        basis += [
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * z * z - x * x - y * y),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (x * x - y * y),
        ]
    if bands > 3:
        basis += [
            -0.5900435899266435 * y * (3 * x * x - y * y),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
            0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -0.4570457994644658 * x * (4 * z * z - x * x - y * y),
            1.445305721320277 * z * (x * x - y * y),
            -0.5900435899266435 * x * (x * x - 3 * y * y),
        ]
    return np.array(basis)


def splat_image(splats, camera, near=0.01):
    """Return colour, alpha and mean depth of `splat_layers`."""
    layers = splat_layers(splats, camera, near)
    return layers["color"], layers["alpha"], layers["depth"]


def splat_layers(splats, camera, near=0.01, drop_last=False):
    """Blend splats in order of depth, each over every pixel; return all layers by name."""
    height, width = camera.height, camera.width
    view, turn = camera.camera_from_world, camera.camera_from_world[:3, :3]
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    color = np.zeros((height, width, 3))
    depth = np.zeros((height, width))
    clear = np.ones((height, width))
    median = np.full((height, width), np.inf)
    hit = np.full((height, width), -1)
    normal = np.zeros((height, width, 3))
    distance = np.zeros((height, width))
    ended = np.zeros((height, width), bool)
    position = np.asarray(splats.position, float) @ turn.T + view[:3, 3]
    bands = int(np.sqrt(splats.sh.shape[1]))
    for s in np.argsort(position[:, 2], kind="stable"):
        x, y, z = position[s]
        if not z >= near:
            continue
        own = quaternion_matrix(splats.rotation[s]) * np.asarray(splats.scale[s], float)
        cov = turn @ own @ own.T @ turn.T
        if camera.orthographic:
            jacobian = np.array([[camera.fx, 0, 0], [0, camera.fy, 0]])
            u, v = camera.fx * x + camera.cx, camera.fy * y + camera.cy
            direction = camera.forward
        else:
            margin = 0.15
            lx = np.clip(x / z, (-camera.cx - margin * width) / camera.fx,
                         (width - camera.cx + margin * width) / camera.fx)  # fmt: skip
            ly = np.clip(y / z, (-camera.cy - margin * height) / camera.fy,
                         (height - camera.cy + margin * height) / camera.fy)  # fmt: skip
            jacobian = np.array(
                [[camera.fx / z, 0, -camera.fx * lx / z], [0, camera.fy / z, -camera.fy * ly / z]]
            )
            u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
            direction = splats.position[s] - camera.position
            direction = direction / np.linalg.norm(direction)
        conic = np.linalg.inv(jacobian @ cov @ jacobian.T + 0.3 * np.eye(2))
        dx, dy = column - u, row - v
        power = conic[0, 0] * dx * dx + 2 * conic[0, 1] * dx * dy + conic[1, 1] * dy * dy
        alpha = np.minimum(float(splats.opacity[s]) * np.exp(-0.5 * power), 0.999)
        alpha[alpha < 1 / 255] = 0
        basis = sh_basis(direction, bands)
        shade = np.maximum(basis @ np.asarray(splats.sh[s], float) + 0.5, 0)
        alpha[ended] = 0
        if drop_last:
            ended |= (alpha > 0) & (clear * (1 - alpha) <= 1e-4)
            alpha[ended] = 0
        weight = alpha * clear
        color += weight[..., None] * shade
        depth += weight * z
        axis = turn @ quaternion_matrix(splats.rotation[s])[:, np.argmin(splats.scale[s])]
        towards = axis[2] if camera.orthographic else axis @ position[s]
        axis = -axis if towards > 0 else axis
        normal += weight[..., None] * axis
        distance += weight * (axis @ position[s])
        half = (clear > 0.5) & (clear - weight <= 0.5)
        median[half], hit[half] = z, s
        clear -= weight
    alpha = 1 - clear
    with np.errstate(invalid="ignore", divide="ignore"):
        depth = np.where(alpha >= 0.02, depth / alpha, np.inf)
        rays = np.stack([(column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy], -1)
        flat = np.einsum("ijk,ijk->ij", normal[..., :2], rays)
        if camera.orthographic:
            along, plane = normal[..., 2], (distance - flat) / normal[..., 2]
        else:
            along = flat + normal[..., 2]
            plane = distance / along
        usable = along <= -0.02 * alpha
        usable &= camera.orthographic | (np.abs(plane - depth) < 0.2 * depth)
        return {
            "color": color, "alpha": alpha, "depth": depth, "median": median, "hit": hit,
            "plane_depth": np.where(usable, plane, depth),
            "normal": normal / np.linalg.norm(normal, axis=-1, keepdims=True),
        }  # fmt: skip


def decibel(a, b, peak=255.0):
    """PSNR of two pictures or layers whose largest value is `peak`; at most 120 dB."""
    error = np.mean((np.asarray(a, float) - np.asarray(b, float)) ** 2) / peak**2
    return -10 * np.log10(max(error, 1e-12))
