"""A made-up garden on one of its days in Mitsuba, a path tracer (extra `truth`).

Traps met: textures of vertex colours have no mean, so parts under a coat need pictures; rays start
0.7 mm off a surface seen from 4 m, so a sheet of water over a bed is a smooth coat on the bed,
lifted to the water's level (over grey it is real water to 0.5 %).
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from benchmarks.day_case import COATS, SKIN, TINT
from benchmarks.day_shapes import grid_faces
from rainsim.constants import REFRACTIVE_INDEX
from rainsim.errors import ParameterError

GLASS_INDEX = 1.5
BOUNCES = 10
# Of light that a rough white body sends to a water surface from below, and of daylight that enters
# it (Lekner and Dorf 1988): wet albedo is ENTERS * LEAVES * a / (1 - KEPT * a).
ENTERS, KEPT = 0.934, 0.4746
LEAVES = 1 - KEPT
DULL, SUNNY = "dull", "sun"


def under_skin(albedo):
    """Return the albedo below a coat at which the coated body has this albedo besides its gloss."""
    return albedo / (ENTERS * LEAVES + KEPT * albedo)


def require_mitsuba():
    """Return the module Mitsuba, set to compile for the processor, or raise naming the remedy."""
    try:
        import mitsuba
    except ImportError:
        raise ParameterError(
            "the truth is path-traced with Mitsuba, which is not installed; run pip install "
            '"rainsim[truth]", or leave out --remake'
        ) from None
    try:
        mitsuba.set_variant("llvm_ad_rgb")
        mitsuba.Float(1.0) + 1.0
    except Exception as error:
        raise ParameterError(
            f"Mitsuba cannot compile for this processor ({str(error).splitlines()[0]}); it needs "
            "the LLVM library, version 19; set DRJIT_LIBLLVM_PATH to the file libLLVM.so.19.1"
        ) from error
    return mitsuba


def overcast_sky(rows=128):
    """Return the overcast sky of Moon and Spencer (1942) as a picture of latitudes, zenith 1."""
    sine = np.sin((0.5 - (np.arange(rows) + 0.5) / rows) * np.pi)
    radiance = np.where(sine > 0, (1 + 2 * np.maximum(sine, 0)) / 3, 0.1)
    return np.repeat(radiance[:, None, None] * TINT, 2 * rows, axis=1).astype(np.float32)


class Garden:
    """A case on one of its days, loaded into Mitsuba.

    `day` is a `Rain`, "sun", or "dull": dry under the overcast sky. Without `mirrors` water mirrors
    nothing, so that the difference of two gardens is the light that it mirrors.
    """

    def __init__(self, mitsuba, case, shapes, paving, day, mirrors=True):
        self.mitsuba, self.mirrors = mitsuba, mirrors
        self.rain = None if isinstance(day, str) else day
        entries = {"type": "scene", "sky": self._sky(case.sun, day)}
        for part, mesh in shapes.meshes.items():
            entries |= self._part(part, mesh, shapes.pictures.get(part))
        if self.rain:
            entries["water"] = self._water(paving, shapes.pictures["paving"])
        self.scene = mitsuba.load_dict(entries)
        self.integrator = mitsuba.load_dict({"type": "path", "max_depth": BOUNCES})

    def _sky(self, sun, day):
        if day == SUNNY:
            return {"type": "sunsky", "sun_direction": sun.direction.tolist(), "albedo": 0.2,
                    "turbidity": sun.turbidity}  # fmt: skip
        turn = self.mitsuba.ScalarTransform4f().rotate([1, 0, 0], 90)
        return {"type": "envmap", "bitmap": self.mitsuba.Bitmap(overcast_sky()), "to_world": turn}

    def _part(self, part, mesh, picture):
        """Return the shapes of a part by name: diffuse, of glass, or under a coat of water."""
        albedo, normals = mesh.albedo, mesh.normals
        if self.rain and part in SKIN:
            albedo = self.rain.skin * albedo
        if part == "glass":
            color = {"type": "rgb", "value": albedo[0].tolist()}
            surface = {"type": "plastic", "int_ior": GLASS_INDEX, "ext_ior": 1.0,
                       "diffuse_reflectance": color}  # fmt: skip
        elif self.rain and part in self.rain.coated:
            if part == "leaf":
                return self._leaf_groups(mesh.vertices, mesh.faces, albedo)
            below = albedo[0] if picture is None else picture.albedo
            if part in SKIN:
                below = under_skin(self.rain.skin * below)
            surface = self._coat(self.rain.slopes * COATS[part], below)
        else:
            color = {"type": "mesh_attribute", "name": "vertex_color"}
            surface = {"type": "twosided", "below": {"type": "diffuse", "reflectance": color}}
        return {
            part: self._mesh(part, mesh.vertices, mesh.faces, albedo, surface, normals, picture)
        }

    def _coat(self, slope, albedo):
        """Return a coat of water over a colour or a picture of albedo; slope 0 is smooth."""
        albedo = np.asarray(albedo, np.float32)
        texture = {"type": "rgb", "value": albedo.tolist()} if albedo.ndim == 1 else {
            "type": "bitmap", "raw": True, "wrap_mode": "clamp",
            # The first row of a bitmap has the least v, as that of a `Picture`.
            "bitmap": self.mitsuba.Bitmap(np.ascontiguousarray(albedo)),
        }  # fmt: skip
        coat = {"type": "plastic", "int_ior": REFRACTIVE_INDEX, "ext_ior": 1.0, "nonlinear": True,
                "diffuse_reflectance": texture,
                "specular_reflectance": 1.0 if self.mirrors else 0.0}  # fmt: skip
        if slope:
            coat |= {"type": "roughplastic", "distribution": "beckmann",
                     "alpha": float(np.sqrt(2) * slope)}  # fmt: skip
        return {"type": "twosided", "below": coat}

    def _leaf_groups(self, vertices, faces, albedo, groups=12):
        """Return leaves under coats as meshes of one green each: a coat takes one colour."""
        green = albedo[faces[:, 0], 1]
        edges = np.quantile(green, np.linspace(0, 1, groups + 1)[1:-1])
        group = np.searchsorted(edges, green)
        found = {}
        for k in np.unique(group):
            part = faces[group == k]
            below = under_skin(albedo[part[:, 0]].mean(axis=0))
            coat = self._coat(self.rain.slopes * COATS["leaf"], below)
            found[f"leaf{k}"] = self._mesh(f"leaf{k}", vertices, part, None, coat)
        return found

    def _water(self, paving, picture):
        """Return the puddles: a smooth coat with the bed's albedo at the water's level."""
        wet = paving.depth > 0
        any_wet = wet[:-1, :-1] | wet[1:, 1:] | wet[:-1, 1:] | wet[1:, :-1]
        height = np.where(wet, paving.level, -1)
        # Beyond the waterline the sheet goes on level, below the bed.
        beyond = np.minimum(ndimage.grey_dilation(height, 3), paving.bed - 1e-5)
        points = paving.points
        points[..., 2] = np.where(wet, paving.level, beyond)
        up = np.zeros_like(points)
        up[..., 2] = 1
        faces = grid_faces(*wet.shape, any_wet)
        coat = self._coat(0, picture.albedo)
        return self._mesh(
            "water", points.reshape(-1, 3), faces, None, coat, up.reshape(-1, 3), picture
        )

    def _mesh(self, name, vertices, faces, albedo, surface, normals=None, picture=None):
        """Return a mesh with its reflectance, without the vertices that no face uses."""
        properties = self.mitsuba.Properties()
        properties["bsdf"] = self.mitsuba.load_dict(surface)
        used = np.unique(faces)
        place = np.zeros(len(vertices), np.int64)
        place[used] = np.arange(len(used))
        mesh = self.mitsuba.Mesh(
            name, len(used), len(faces), has_vertex_normals=normals is not None,
            has_vertex_texcoords=picture is not None, props=properties,
        )  # fmt: skip
        if albedo is not None:
            mesh.add_attribute("vertex_color", 3, albedo[used].astype(np.float32).ravel())
        values = self.mitsuba.traverse(mesh)
        values["vertex_positions"] = vertices[used].astype(np.float32).ravel()
        if normals is not None:
            values["vertex_normals"] = normals[used].astype(np.float32).ravel()
        if picture is not None:
            coordinates = picture.texture_coordinates(vertices[used])
            values["vertex_texcoords"] = coordinates.astype(np.float32).ravel()
        values["faces"] = place[faces].astype(np.uint32).ravel()
        values.update()
        return mesh

    def radiance(self, origins, directions, samples, seed, at_once=8, block=60_000):
        """Return the radiance that rays meet, shape (n, 3)."""
        found = np.empty((len(origins), 3))
        for start in range(0, len(origins), block):
            part = slice(start, start + block)
            total = 0.0
            for k in range(-(-samples // at_once)):
                total = total + self._radiance(
                    origins[part], directions[part], at_once, (seed + start) * 997 + k
                )
            found[part] = total / -(-samples // at_once)
        return found

    def _radiance(self, origins, directions, samples, seed):
        mitsuba = self.mitsuba
        o, d = (
            [mitsuba.Float(np.repeat(a[:, c].astype(np.float32), samples)) for c in range(3)]
            for a in (origins, directions)
        )
        ray = mitsuba.RayDifferential3f(mitsuba.Point3f(*o), mitsuba.Vector3f(*d))
        sampler = mitsuba.load_dict({"type": "independent"})
        sampler.seed(seed, len(origins) * samples)
        light = np.array(self.integrator.sample(self.scene, sampler, ray)[0])
        return light.reshape(3, len(origins), samples).mean(axis=-1).T

    def picture(self, camera, samples, at_once=16):
        """Return the radiance of a camera's picture and its standard error, (height, width, 3)."""
        mitsuba = self.mitsuba
        eye, ahead = camera.position, camera.forward
        sensor = mitsuba.load_dict({
            "type": "perspective", "fov_axis": "x",
            "fov": float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))),
            "to_world": mitsuba.ScalarTransform4f().look_at(
                origin=eye.tolist(), target=(eye + ahead).tolist(), up=[0, 0, 1]
            ),
            "film": {"type": "hdrfilm", "width": camera.width, "height": camera.height,
                     "rfilter": {"type": "box"}, "pixel_format": "rgb"},
            "sampler": {"type": "independent"},
        })  # fmt: skip
        total, square, count = 0.0, 0.0, max(2, samples // at_once)
        for seed in range(count):
            one = np.array(mitsuba.render(
                self.scene, sensor=sensor, integrator=self.integrator, spp=at_once, seed=seed
            ))[..., :3].astype(float)  # fmt: skip
            total, square = total + one, square + one**2
        mean = total / count
        return mean, np.sqrt(np.maximum(square / count - mean**2, 0) / (count - 1))

    def meet(self, origins, directions):
        """Return the point and normal that rays meet first and the number of its part, -1: sky."""
        import drjit

        mitsuba = self.mitsuba
        found = self.scene.ray_intersect(self._rays(origins, directions))
        hit = np.array(found.is_valid())
        shape = drjit.reinterpret_array(mitsuba.UInt32, found.shape)
        part = np.full(len(directions), -1)
        names = []
        for one in self.scene.shapes():
            own = drjit.reinterpret_array(mitsuba.UInt32, mitsuba.ShapePtr(one))
            part[np.array(shape == own) & hit] = len(names)
            names.append(one.id())
        return np.array(found.p).T, np.array(found.n).T, part, names

    def blocked(self, origins, directions):
        """Return whether rays meet anything."""
        return np.array(self.scene.ray_test(self._rays(origins, directions)))

    def _rays(self, origins, directions):
        mitsuba = self.mitsuba
        o, d = (
            [mitsuba.Float(np.ascontiguousarray(a[:, c], np.float32)) for c in range(3)]
            for a in np.broadcast_arrays(origins, directions)
        )
        return mitsuba.Ray3f(mitsuba.Point3f(*o), mitsuba.Vector3f(*d))
