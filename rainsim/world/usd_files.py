"""USD stages of a scene in the rain: a layer for each part, and `world.usda`, which joins them.

All are in the ground frame, in metres with z up; a time code is a frame.
"""

from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from rainsim.errors import RainsimError
from rainsim.io.files import replacing
from rainsim.scene.usd_guard import reason

SENSOR = 0.036  # m, width that a camera's picture is given: 36 mm, as on film of 35 mm
TENTH = 10.0  # lenses of USD are in tenths of a unit
CLIPPING = 0.05, 1e4  # m
ROOT = "/World"
SETTINGS = "/Render/Settings"
WORLD = "world.usda"


class Clock(NamedTuple):
    """The frames of a stage: number of the first, how many (0 if nothing moves), frames/s."""

    first: float
    count: int
    fps: float

    def code(self, index):
        """Return the time code of the frame `index`, counted from 0."""
        return self.first + index

    def codes(self, index, count):
        """Return the time code of one of `count` values, as a tuple; () of a single one."""
        return () if count == 1 else (self.code(index),)


class Layer:
    """A stage that is filled in memory and written at once, whole or not at all.

    With a `path` it is a file from the first: what `save` has written leaves the memory.
    """

    def __init__(self, clock, path=None):
        from pxr import Usd, UsdGeom

        self.path = path
        self.stage = Usd.Stage.CreateInMemory() if path is None else Usd.Stage.CreateNew(str(path))
        self.root = UsdGeom.Xform.Define(self.stage, ROOT)
        _dress(self.stage.GetRootLayer(), clock)

    def save(self):
        """Write what was added since the last time to the layer's own file."""
        with _writing(self.path):
            self.stage.GetRootLayer().Save()

    def write(self, path):
        """Write the stage; what the name ends in is the format."""
        with replacing(path) as temporary, _writing(path):
            self.stage.GetRootLayer().Export(str(temporary))


@contextmanager
def _writing(path):
    """Raise RainsimError in one line where the library cannot write, as on a full disk."""
    from pxr import Tf

    try:
        yield
    except Tf.ErrorException as error:
        raise RainsimError(
            f"{path.parent} did not take a USD file ({reason(error)}); the folder must have room "
            "and take files; make room, or give another --out"
        ) from None


def _dress(layer, clock):
    """Give a layer its default prim, axes, units and times."""
    layer.defaultPrim = ROOT[1:]
    layer.pseudoRoot.SetInfo("upAxis", "Z")
    layer.pseudoRoot.SetInfo("metersPerUnit", 1.0)
    layer.pseudoRoot.SetInfo("renderSettingsPrimPath", SETTINGS)
    if clock.count:
        layer.startTimeCode, layer.endTimeCode = clock.first, clock.code(clock.count - 1)
    layer.framesPerSecond = layer.timeCodesPerSecond = clock.fps


def write_world(path, names, clock, capture_from_ground=None):
    """Write the stage that has the layers `names`, files beside it."""
    from pxr import Gf, Sdf

    layer = Sdf.Layer.CreateAnonymous(WORLD)
    Sdf.CreatePrimInLayer(layer, ROOT).specifier = Sdf.SpecifierDef
    layer.GetPrimAtPath(ROOT).typeName = "Xform"
    _dress(layer, clock)
    if capture_from_ground is not None:
        matrix = Gf.Matrix4d(capture_from_ground.T.tolist())
        layer.customLayerData = {"captureFromGround": matrix}
    layer.subLayerPaths = [f"./{name}" for name in names]
    with replacing(path) as temporary, _writing(path):
        layer.Export(str(temporary))


def camera_layer(cameras, clock, exposure):
    """Return the Layer of a camera, one per frame or one for all, and the pictures' size."""
    from pxr import Gf, UsdGeom, UsdRender

    layer = Layer(clock)
    made = UsdGeom.Camera.Define(layer.stage, f"{ROOT}/Camera")
    place = made.AddTransformOp()
    made.CreateClippingRangeAttr(Gf.Vec2f(*CLIPPING))
    made.CreateShutterCloseAttr(exposure * clock.fps)
    attributes = (
        made.CreateFocalLengthAttr(), made.CreateHorizontalApertureAttr(),
        made.CreateVerticalApertureAttr(), made.CreateHorizontalApertureOffsetAttr(),
        made.CreateVerticalApertureOffsetAttr(),
    )  # fmt: skip
    for index, camera in enumerate(cameras):
        matrix = np.linalg.inv(camera.camera_from_world)
        matrix[:3, 1:3] *= -1  # our axes to OpenGL's
        place.Set(Gf.Matrix4d(matrix.T.tolist()), *clock.codes(index, len(cameras)))
    for attribute, values in zip(attributes, zip(*map(_lens, cameras), strict=True), strict=True):
        values = values[:1] if len(set(values)) == 1 else values
        for index, value in enumerate(values):
            attribute.Set(value, *clock.codes(index, len(values)))
    settings = UsdRender.Settings.Define(layer.stage, SETTINGS)
    settings.CreateCameraRel().SetTargets([made.GetPath()])
    settings.CreateResolutionAttr(Gf.Vec2i(cameras[0].width, cameras[0].height))
    settings.CreatePixelAspectRatioAttr(cameras[0].fy / cameras[0].fx)
    return layer


def _lens(camera):
    """Return focal length, apertures and their offsets in tenths of a metre."""
    wide = TENTH * SENSOR
    focal = camera.fx / camera.width * wide
    tall = camera.height / camera.width * (camera.fx / camera.fy) * wide
    aside, down = camera.cx / camera.width - 0.5, camera.cy / camera.height - 0.5
    return focal, wide, tall, -aside * wide, down * tall


def ground_layer(ground, clock):
    """Return the Layer of a `meshes.Ground`."""
    from pxr import UsdGeom, Vt

    layer = Layer(clock)
    mesh = _mesh(layer, "Ground")
    _set_faces(mesh, ground.points, ground.quads)
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(ground.normals))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    color = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
    color.Set(Vt.Vec3fArray.FromNumpy(ground.colors))
    return layer


class WaterLayer(Layer):
    """Puddles over time; their faces change from frame to frame."""

    def __init__(self, clock, path):
        from pxr import Sdf, UsdGeom

        super().__init__(clock, path)
        self._mesh = _mesh(self, "Water")
        primvars, vertex = UsdGeom.PrimvarsAPI(self._mesh), UsdGeom.Tokens.vertex
        types = Sdf.ValueTypeNames
        self._depth = primvars.CreatePrimvar("depth", types.FloatArray, vertex)
        self._flow = primvars.CreatePrimvar("flow", types.Vector3fArray, vertex)

    def add(self, code, water):
        """Add the `meshes.Water` of a time code."""
        from pxr import Vt

        _set_faces(self._mesh, water.points, water.quads, code)
        self._depth.Set(Vt.FloatArray.FromNumpy(water.depth), code)
        self._flow.Set(Vt.Vec3fArray.FromNumpy(water.flow), code)


class RainLayer(Layer):
    """Drops and droplets as points, crowns and jets as threads, over time."""

    def __init__(self, clock, path):
        from pxr import UsdGeom

        super().__init__(clock, path)
        UsdGeom.Xform.Define(self.stage, f"{ROOT}/Rain")
        self._points = [
            UsdGeom.Points.Define(self.stage, f"{ROOT}/Rain/{name}")
            for name in ("Drops", "Droplets")
        ]
        self._crowns = UsdGeom.BasisCurves.Define(self.stage, f"{ROOT}/Rain/Crowns")
        self._crowns.CreateTypeAttr(UsdGeom.Tokens.linear)
        self._crowns.SetWidthsInterpolation(UsdGeom.Tokens.uniform)

    def add(self, code, falling):
        """Add the `falling.Falling` of a time code."""
        from pxr import Vt

        for points, rows in zip(self._points, (falling.drops, falling.droplets), strict=True):
            place, velocity = (
                np.ascontiguousarray(rows[:, columns], np.float32)
                for columns in (slice(0, 3), slice(3, 6))
            )
            _set_places(points, place, rows[:, 6], code)
            points.CreateVelocitiesAttr().Set(Vt.Vec3fArray.FromNumpy(velocity), code)
        ends = np.ascontiguousarray(falling.crowns[:, :6].reshape(-1, 3), np.float32)
        _set_places(self._crowns, ends, falling.crowns[:, 6], code)
        counts = np.full(len(falling.crowns), 2, np.int32)
        self._crowns.CreateCurveVertexCountsAttr().Set(Vt.IntArray.FromNumpy(counts), code)


def capture_layer(scene, clock):
    """Return the Layer of a capture's splats, numbers as trained, placed in the ground frame."""
    from pxr import Gf, UsdVol, Vt

    layer, splats, frame = Layer(clock), scene.splats, scene.ground_frame
    field = UsdVol.ParticleField3DGaussianSplat.Define(layer.stage, f"{ROOT}/Capture")
    matrix = np.eye(4)
    matrix[:3, :3] = frame.meters_per_unit * frame.rotation
    matrix[:3, 3] = frame.translation
    field.AddTransformOp().Set(Gf.Matrix4d(matrix.T.tolist()))
    degree = round(splats.sh.shape[1] ** 0.5) - 1
    turn = np.ascontiguousarray(np.roll(splats.rotation, -1, axis=1))  # its real part last
    for create, values in (
        (field.CreatePositionsAttr, Vt.Vec3fArray.FromNumpy(splats.position)),
        (field.CreateOrientationsAttr, Vt.QuatfArray.FromNumpy(turn)),
        (field.CreateScalesAttr, Vt.Vec3fArray.FromNumpy(splats.scale)),
        (field.CreateOpacitiesAttr, Vt.FloatArray.FromNumpy(splats.opacity)),
        (field.CreateRadianceSphericalHarmonicsDegreeAttr, degree),
        (field.CreateRadianceSphericalHarmonicsCoefficientsAttr,
         Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(splats.sh.reshape(-1, 3)))),
    ):  # fmt: skip
        create().Set(values)
    reach = 3 * splats.scale.max(axis=1, keepdims=True)
    corners = [(splats.position - reach).min(axis=0), (splats.position + reach).max(axis=0)]
    field.CreateExtentAttr(Vt.Vec3fArray([Gf.Vec3f(*map(float, c)) for c in corners]))
    return layer


def _mesh(layer, name):
    from pxr import UsdGeom

    mesh = UsdGeom.Mesh.Define(layer.stage, f"{ROOT}/{name}")
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    return mesh


def _set_faces(mesh, points, quads, *code):
    from pxr import UsdGeom, Vt

    places = Vt.Vec3fArray.FromNumpy(points)
    mesh.CreatePointsAttr().Set(places, *code)
    mesh.CreateFaceVertexCountsAttr().Set(Vt.IntArray([4] * len(quads)), *code)
    mesh.CreateFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(quads.reshape(-1)), *code)
    _set_extent(mesh, UsdGeom.PointBased.ComputeExtent(places), len(points), code)


def _set_places(prim, places, widths, code):
    """Set points and widths [m] of points or curves at a time code."""
    from pxr import UsdGeom, Vt

    widths = np.ascontiguousarray(widths, np.float32)
    prim.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(places), code)
    prim.CreateWidthsAttr().Set(Vt.FloatArray.FromNumpy(widths), code)
    extent = UsdGeom.PointBased.ComputeExtent(Vt.Vec3fArray.FromNumpy(places))
    if len(places):
        reach = float(widths.max()) / 2
        extent[0] -= type(extent[0])(reach)
        extent[1] += type(extent[1])(reach)
    _set_extent(prim, extent, len(places), (code,))


def _set_extent(prim, extent, count, code):
    from pxr import Gf, Vt

    nothing = Vt.Vec3fArray([Gf.Vec3f(0), Gf.Vec3f(0)])
    prim.CreateExtentAttr().Set(extent if count else nothing, *code)
