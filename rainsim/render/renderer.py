"""Rainy frames on the CPU: a capture, its terrain and the water's state in, pictures out.

`rainsim.render.frame` names the passes of a picture, `rainsim.render.conductor` puts what they
read, `rainsim.render.passes` computes them.
"""

from rainsim.reflection.water_pass import WetPicture, choice_of
from rainsim.render.conductor import Conductor
from rainsim.render.layers import buffers_of, facts_of
from rainsim.render.passes import Passes
from rainsim.render.report import FrameReport, Timer
from rainsim.render.weather import weather_of


class Renderer:
    """Draws frames of one scene, terrain and configuration.

    What a still camera sees without water is drawn once.

    Parameters
    ----------
    scene : Scene
    terrain : Terrain
    config : Config
    first_camera : Camera
        In the capture frame; the surroundings are drawn from its place, and a capture without
        cameras is metered by it, see `fixed_camera`.

    Attributes
    ----------
    conductor : Conductor
        Scene, light, weather and ground; its `frame` has the inputs and buffers of the last
        picture by name.
    passes : Passes
    takes_any_height : bool
        Whether a picture of another height than the last costs nothing more.

    Examples
    --------
    >>> renderer = rainsim.Renderer(scene, terrain, config, scene.cameras[0])
    >>> picture, report = renderer.draw(scene.cameras[0], state, names=("depth",))
    >>> picture.shape, report.aovs["depth"].shape
    ((48, 64, 3), (48, 64))
    """

    takes_any_height = True

    def __init__(self, scene, terrain, config, first_camera):
        self.conductor = Conductor(scene, terrain, config, first_camera)
        self.passes = Passes()
        self._choice_is_noted = False  # of the reflections

    @property
    def frame(self):
        """The `Frame` of the picture drawn last."""
        return self.conductor.frame

    @property
    def water(self):
        """The `SeenWater` of the picture drawn last."""
        return self.frame["seen"]

    @property
    def wet(self):
        """The `WetPicture` drawn last, without water."""
        names = "picture", "depth", "clearance", "view", "below"
        picture, depth, clearance, view, below = (self.frame[name] for name in names)
        return WetPicture(picture, depth, clearance, view, below)

    def draw(self, camera, state, camera_end=None, names=(), timer=None):
        """Return the picture (height, width, 3) uint8 that a camera takes, and its report.

        Parameters
        ----------
        camera : Camera
            In the capture frame.
        state : SimState
        camera_end : Camera or None
            As the shutter closes, in the ground frame; None: the camera stands still. Only rain
            shows the motion: the capture stays sharp.
        names : sequence of str
            AOVs that the report is to hold, of `aov.AOVS`.
        timer : Timer, optional
            Its `mark` is called between the stages. If it raises, the picture is given up.
        """
        timer, conductor = timer or Timer(), self.conductor
        conductor.roll(state.time, state.depth)
        conductor.take(camera, state, camera_end)
        conductor.take_water(state)
        before = self.frame["image"] if "image" in self.frame else None
        self.frame.make(("image", *buffers_of(names)), self.passes.work, timer.mark)
        if not self._choice_is_noted and (choice := choice_of(self.frame["seen"])):
            self._choice_is_noted = True
            conductor.notes.append(choice)
        image = self.frame["image"]
        image = image.copy() if image is before else image  # nothing has changed since it was drawn
        return image, report_of(conductor, state, timer.stages, names)

    def film(self, shots, names=()):
        """Yield the result of `draw` for each (camera, state, camera_end), one after the other."""
        for camera, state, camera_end in shots:
            yield self.draw(camera, state, camera_end, names)


def report_of(conductor, state, stages, names=(), frame=None):
    """Return the `FrameReport` of a frame whose layers `names` are made; takes over the notes.

    state : SimState or DeviceState
    stages : dict of str to float [ms]
    names : sequence of str
    frame : Frame, optional. That holds the layers; by default the conductor's.
    """
    notes, conductor.notes = (*state.notes, *conductor.notes), []
    given = state.index, state.time, stages, state.ledger, notes
    if not names:
        return FrameReport(*given)
    frame = conductor.frame if frame is None else frame
    light = frame["rain_light"]
    radiances = {
        "drop": light.drops.tolist(), "around": light.around.tolist(), "air": light.air.tolist(),
        "brightness": float(conductor.brightness),
    }  # fmt: skip
    facts = facts_of(names, frame, weather_of(conductor.now, frame["field"]))
    made = zip(names, buffers_of(names), strict=True)
    return FrameReport(*given, {name: frame[buffer].copy() for name, buffer in made}, radiances,
                       facts)  # fmt: skip
