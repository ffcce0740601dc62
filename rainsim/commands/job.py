"""What a command works on, made once: settings, scene, cameras and the output folder."""

from contextlib import contextmanager
from dataclasses import replace

from rainsim.commands import options
from rainsim.commands.compile import compiled_beside
from rainsim.commands.given import cameras_of, check_options, paths_in, scene_of, settings
from rainsim.commands.status import READING, Status
from rainsim.errors import counted

NEAR = 0.05  # m from a camera, within which nothing is drawn


class Job:
    """The options of a command, its settings, status and output folder, and its scene and cameras.

    `given` are the options by name, as they were typed; those of the output folder become
    attributes. The settings are those of the option `preset`, else those of `base`, a Config.

    `load` sets `scene`, and `find_cameras` the frames' `cameras`. `pool` are the processes that
    compile, while `compiling` lasts.
    """

    def __init__(self, given, base=None):
        self.out, self.overwrite = given.pop("out"), given.pop("overwrite", False)
        self.resume, self.as_json = given.pop("resume", False), given.pop("as_json", False)
        self.status = Status(given.pop("quiet"), given.pop("verbose", True))
        self.preset, self.given = given.pop("preset", None), given
        self.config = settings(self.preset, given, base)
        check_options(given)
        self.backend = given.get("backend", "cpu")
        self.scene, self.cameras, self.pool = None, (), None

    def read_masks(self):
        """Return the painted classes and the `WaterMask` of the options, each None without one."""
        classes, water = self.given["class_mask"], self.given["water_mask"]
        if classes is not None:  # imported only where a mask is read: it takes a tenth of a second
            from rainsim.terrain.classify import read_mask

            classes = read_mask(classes)
        if water is not None:
            from rainsim.terrain.poured import read_water_mask

            water = read_water_mask(water, self.given["water_mask_use"])
        return classes, water

    @contextmanager
    def compiling(self, uses):
        """Compile what `uses` lack while the block runs, and end the bar that is shown after it."""
        with self.status, compiled_beside(self.status, uses, self.config.threads) as self.pool:
            yield

    def load(self, name):
        """Load the scene of a name or path; say what was loaded, found and only assumed."""
        self.status.progress(READING, 0, 1)
        scene = scene_of(name, self.given)
        if any(scene.photographs):
            from rainsim.raster import Rasterizer, prepare
            from rainsim.scene.photographs import fidelity_notes

            capture = Rasterizer(prepare(scene.splats))
            near = NEAR / scene.ground_frame.meters_per_unit
            own = {"depth": "median", "compensate": scene.antialiased}
            notes = fidelity_notes(scene, lambda camera: capture.draw(camera, near, **own).color)
            scene = replace(scene, notes=(*scene.notes, *notes))
        self.set_scene(scene)

    def set_scene(self, scene):
        """Set the scene that was loaded; say what it is, and what of it is only assumed."""
        self.scene, cameras = scene, len(scene.cameras)
        self.status.progress(READING, 1, 1)
        self.status.say(
            f"scene {scene.name}: {scene.count:,} splats, {counted(cameras, 'camera')}"
            + (f", {len(scene.actors)} actors" if scene.actors else "")
        )
        self.status.notes(scene.notes)
        self.status.notes(scene.ground_frame.notes)

    def tell_ground(self, ground):
        """Say how large the ground is that was found, and how much of it is known."""
        import numpy as np

        from rainsim.terrain.types import MEASURED

        whole = getattr(ground, "overview", ground)
        (ny, nx), spacing = whole.grid.shape, whole.grid.spacing
        puddles = "assumed" if whole.layer.size else "as measured"
        self.status.notes([
            f"ground: {nx * spacing:.3g} x {ny * spacing:.3g} m, "
            f"{np.mean(whole.source == MEASURED):.0%} measured, puddles {puddles}"
        ])  # fmt: skip

    def find_cameras(self):
        """Find the frames' cameras; the settings get the number of frames that a path has."""
        self.cameras, self.config = cameras_of(
            self.scene, self.config, self.given, say=self.status.notes
        )

    def extract_terrain(self, mask=None, water=None):
        """Return the `Terrain` of the scene."""
        from rainsim.pipeline import extract_terrain

        tell = self.status.progress, self.status.notes
        return extract_terrain(self.scene, self.config, mask, *tell, water)

    @contextmanager
    def folder(self, *sources, shared=False):
        """Claim the output folder and set the number of threads, for a block.

        `sources` are files and folders that are read besides those that options name. A folder is
        `shared` by processes that each draw a range of the frames.
        """
        from rainsim.jit import set_threads
        from rainsim.output_folder.claims import claimed

        sources = [*sources, *paths_in(self.given)]
        with claimed(self.out, self.overwrite, self.resume, sources, shared):
            set_threads(self.config.threads)
            yield

    def finish(self, what, result, text=None, more=""):
        """Say that `what` stands in the output folder and print the result.

        `text` stands for the result where it is not printed as JSON, by default the folder; `more`
        is said after the folder's name.
        """
        from rainsim.output_folder.claims import relative

        self.status.say(f"{what} in {relative(self.out)}{more}")
        options.echo({"out": str(self.out), **result}, self.as_json, text or str(self.out))
