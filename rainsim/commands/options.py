"""Option groups that commands share, and the types of values that have several parts."""

import json
import math
import re
from pathlib import Path

import click

from rainsim.config.preset_files import DEFAULT_PRESET
from rainsim.config.tables import SETTINGS

HEADINGS = "scene", "rain", "look", "camera", "output", "where it is drawn"  # the last: all else
HEADING_OF = {"frames": "output", "fps": "output", "exposure": "camera"}  # elsewhere for others
USUAL = frozenset((
    "preset", "up", "camera_height", "rain", "past_rain", "drying", "wind", "water_level",
    "sun", "cloudiness", "sky", "brightness", "ripples", "camera", "path", "orbit", "drive",
    "frames", "width", "video", "resume", "out", "overwrite", "verbose", "help_all",
))  # fmt: skip
WIDTH = 648  # px, where neither a width nor a height is given
PRESETS = "the preset's"  # shown as the default of options that override a preset


class Numbers(click.ParamType):
    """Numbers separated by commas, such as x,y,z, or one of `words` (with | between them)."""

    name = "numbers"

    def __init__(self, parts, words=""):
        self.parts, self.words = parts.split(","), words

    def get_metavar(self, param, ctx=None):
        """Return how the value is shown in the help."""
        shown = ",".join(self.parts).upper()
        return f"{shown}|{self.words}" if self.words else shown

    def convert(self, value, param, ctx):
        """Return a tuple of floats, or the word itself."""
        if isinstance(value, tuple):
            return value
        if value in self.words.split("|"):
            return value
        try:
            numbers = tuple(float(part) for part in value.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != len(self.parts) or not all(map(math.isfinite, numbers)):
            other = f" or {self.words}" if self.words else ""
            self.fail(
                f"{value!r} is not {len(self.parts)} finite numbers {','.join(self.parts)} "
                f"without spaces{other}",
                param,
                ctx,
            )
        return numbers


class FrameRange(click.ParamType):
    """Frames A:B, B not included."""

    name = "A:B"

    def convert(self, value, param, ctx):
        """Return (A, B)."""
        if isinstance(value, tuple):
            return value
        first, colon, end = value.partition(":")
        if not (colon and first.isdecimal() and end.isdecimal()):
            self.fail(f"{value!r} is not a range A:B of frame numbers, such as 0:24", param, ctx)
        return int(first), int(end)


class KnownLength(Numbers):
    """Two points and the metres between them: in space, or in the picture of a camera."""

    name = "length"

    def __init__(self):
        super().__init__("x1,y1,z1,x2,y2,z2,m")
        self._in_picture = Numbers("u1,v1,u2,v2,m")

    def get_metavar(self, param, ctx=None):
        """Return how the value is shown in the help."""
        return "X1,Y1,Z1,X2,Y2,Z2,M|CAMERA:U1,V1,U2,V2,M"

    def convert(self, value, param, ctx):
        """Return the camera's name or None, and a tuple of floats."""
        if isinstance(value, tuple):
            return value
        camera, colon, numbers = value.rpartition(":")
        if colon:
            return camera, self._in_picture.convert(numbers, param, ctx)
        return None, super().convert(value, param, ctx)


FILE = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)


def group(*options):
    """Return several options as one decorator."""

    def decorate(command):
        for one in reversed(options):
            command = one(command)
        return command

    return decorate


def under(heading, *options):
    """Return several options as one decorator; `Grouped` shows them below a heading."""

    def decorate(command):
        before = len(getattr(command, "__click_params__", ()))
        command = group(*options)(command)
        for added in command.__click_params__[before:]:
            added.heading = HEADING_OF.get(added.name, heading)
        return command

    return decorate


class Grouped(click.Command):
    """A command whose --help has its usual options below headings, --help-all every option."""

    def format_options(self, ctx, formatter):
        """Write the options by heading, each with its help."""
        own = [one for one in self.params if isinstance(one, click.Option)]
        for heading in HEADINGS:
            rows = [
                one.get_help_record(ctx) if ctx.meta.get("all") else _in_short(one, ctx)
                for one in own if getattr(one, "heading", HEADINGS[-1]) == heading
                and (ctx.meta.get("all") or one.name in USUAL)
            ]  # fmt: skip
            if rows:
                with formatter.section(heading.capitalize()):
                    formatter.write_dl(rows)


def _in_short(option, ctx):
    """Return an option's names and the first sentence of its help."""
    return option.get_help_record(ctx)[0], re.split(r"\.( |$)", option.help)[0]


def _show_all(ctx, param, value):
    if value:
        ctx.meta["all"] = True
        click.echo(ctx.get_help())
        ctx.exit()


def option(names, kind, text, metavar=None, shows=None, **more):
    """Return an option that is no setting, declared in one call as a setting is.

    `names` is its name without dashes, and after a space the letter or parameter that it also is
    called; `kind` the type of its value, bool for a switch; `text` its help. `shows` is what the
    help gives as its default, in place of the `default` that it has.
    """
    name, *others = names.split()
    if kind is bool:
        return click.option(f"--{name}", *others, is_flag=True, help=text, **more)
    if shows is None and "default" in more:
        shows = True
    return click.option(f"--{name}", *others, type=kind, help=text, metavar=metavar,
                        show_default=shows, **more)  # fmt: skip


# fmt: off
scene_option = option(
    "scene -s", str,
    "A name from `rainsim scenes`, a trained model's folder, a splat file or a scene folder.",
    "NAME|PATH")

ground_options = group(
    option("cameras", FILE, "cameras.json or transforms.json instead of the one beside the splats. "
           "A camera of USD, glTF or Blender is taken as --path.", "FILE"),
    option("photos", FOLDER, "Photographs of the capture's cameras, if not in images/ or input/ "
           "beside it: their GPS gives the scale, place and time the captured sun.", "DIR"),
    option("up", Numbers("x,y,z"), "Direction that is roughly up, in the capture's own axes."),
    option("meters-per-unit", float, "Scale: metres per capture unit.", "S"),
    option("camera-height", float, "Scale from the cameras' mean height above the ground, in "
           "metres. [default: GPS of the photographs, else 1.8 is assumed, from the air asked for]",
           "M"),
    option("known-length", KnownLength(), "Scale from two points and the metres between them: in "
           "capture units, or as columns and rows of a camera's full picture."),
    option("spz-frame", click.Choice(["rub", "rdf"]), "Axes of an SPZ file that does not name "
           "them: right, up, back or right, down, forward. [default: those in which its cameras "
           "see]"),
    option("fall", Numbers("percent,direction"), "Slope of the ground in percent, and the "
           "direction in which it goes down, in degrees counter-clockwise from the first camera's "
           "view; without it the ground is made level."),
    option("ground-frame", FILE, "Up, scale and origin of the ground in one file, as `rainsim "
           "import` writes it.", "FILE.json"),
)

mask_options = group(
    option("class-mask", FILE, "Classes painted in the colours of classes.png; black is left to "
           "the program.", "FILE.png"),
    option("water-mask", FILE, "Water at the start: a grey picture of the height map's cells, its "
           "value the depth in mm.", "FILE.png"),
    option("water-mask-use", click.Choice(["stays", "drains"]), "stays: the ground is dented by "
           "the depth, so that the water stays; drains: it is poured, and stands where the ground "
           "dips.", default="stays"),
)

fov_option = option(
    "fov", float, "Horizontal field of view with --eye, in degrees. [default: 60]", "DEG")
eye_options = group(
    option("eye", Numbers("x,y,z"), "Where to look from, in capture units."),
    option("look-at", Numbers("x,y,z"), "Where to look to, in capture units."),
)

shot_options = group(
    option("path-camera", str, "Which camera of a USD or glTF file with several: its name or whole "
           "path.", "NAME"),
    option("path-in", click.Choice(["ground", "capture"]), "Coordinates of a camera of USD, glTF "
           "or Blender: ground, those that `rainsim world` writes, in metres with z up; capture, "
           "the splats' own, and the numbers count as they stand.", shows="ground"),
)

camera_options = group(
    option("camera", str, "A camera of the capture. [default: the one that shows most water]",
           "NAME"),
    option("path", FILE, "A camera path, one camera per frame: transforms.json, a camera_path.json "
           "of `rainsim view` or nerfstudio, or a camera of USD, glTF or Blender. A single camera "
           "stands still for --frames.", "FILE"),
    shot_options,
    option("orbit", bool, "A full circle around the point that the capture's cameras look at."),
    option("drive", bool, "The capture's own cameras in their order, one per frame."),
    eye_options,
    fov_option,
)

preset_option = option(
    "preset -p", str, "A name from `rainsim presets`, or a file of such settings.",
    "NAME|FILE.toml", default=DEFAULT_PRESET)
# fmt: on

PANELS = {  # group of settings: its options, where a setting names no others
    "rain": "rain", "water": "rain", "render": "light", None: "rain", "terrain": "terrain",
}  # fmt: skip


def _of_setting(name, text=""):
    """Return the option of a setting; `text` is a help text in place of its own."""
    setting, declared = SETTINGS[name], SETTINGS[name].option
    kind, metavar = str, declared.metavar
    if len(setting.keys) > 1:
        parts, _, words = metavar.partition("|")
        kind, metavar = Numbers(parts.lower(), words), None
    elif setting.kind.startswith(("float", "int")):
        kind = float if setting.is_number else int
    text, unit = text or declared.help or setting.keys[0].meaning, setting.keys[0].unit
    if unit and unit not in (word.strip(",;:") for word in text.split()):
        text = re.sub("[:;]|$", f", in {unit}\\g<0>", text, count=1)
    if text.split()[0].rstrip(":") not in setting.choices:
        text = text[0].upper() + text[1:]
    return option(declared.name.replace("_", "-"), kind, f"{text}.", metavar, declared.default)


def _of_panel(panel):
    """Return the options of the settings that belong to a panel, as one decorator."""
    own = {name: one.option.panel or PANELS[one.group]
           for name, one in SETTINGS.items() if one.option}  # fmt: skip
    return group(*(_of_setting(name) for name, its in own.items() if its == panel))


rain_options = _of_panel("rain")
light_options = _of_panel("light")
big_options = _of_panel("big")
terrain_options = _of_panel("terrain")
ground_map_option = _of_panel("ground_map")
shower_options = group(  # for commands whose --rain takes several rates
    _of_setting("past", "Rain that fell before and stands in puddles, in mm; none for 0 mm/h"),
    _of_setting("wind", "Wind in m/s and the direction in which the air moves, in degrees"),
    _of_setting("seed"),
)

size_options = _of_panel("picture")
# fmt: off
picture_options = group(
    size_options,
    option("video", bool, "Also write video.mp4, or video.mov for ProRes (needs rainsim[video])."),
    option("video-codec", click.Choice(["h264", "h265", "prores"]), "With --video: h264 plays "
           "everywhere; h265 takes less space; prores, 422 HQ of 10 bits, is for editing and "
           "large.", shows="h264"),
    option("video-quality", click.IntRange(0, 100), "With --video: higher is better and larger. "
           "For h264 and h265 it is a CRF of 51 - N/2: 66 is CRF 18, which looks lossless, 56 is "
           "CRF 23. For prores it is a quantiser of 64^(1 - N/100).", "0..100",
           shows="the codec's: h264 82, h265 70, prores the rate of 422 HQ"),
    option("layers", str, "Also write parts of each frame for compositing, such as "
           "depth,water_depth.", "all|NAME,NAME", shows="none"),
    option("exr", bool, "Also write one OpenEXR file a frame, in linear light, with all that it is "
           "composed of (needs rainsim[exr])."),
    option("exr-name", str, "With --exr: name of the files, with the place of the frame's number.",
           "NAME.%04d.exr", shows="rain.%04d.exr"),
    option("frame-start", click.IntRange(0, 10**8), "With --exr and --video: number of the first "
           "frame, in names, headers and time code.", "N", shows="the path's, or 0"),
    option("colorspace", click.Choice(["rec709", "acescg"]), "With --exr: of the light in it, "
           "linear Rec. 709 or ACEScg.", shows="rec709"),
)

optics_options = group(
    option("lens", str, "Distort pictures, layers and labels: opencv:k1,k2,p1,p2[,k3] or "
           "fisheye:k1,k2,k3,k4, as OpenCV has them, or that of a transforms.json or COLMAP model.",
           "MODEL:K1,K2,...|FILE", shows="pinhole"),
    option("rolling", float, "Readout time of a rolling shutter from the first row to the last, in "
           "ms.", "MS", default=0.0),
    option("glass", Numbers("seconds,speed"), "Drops on a pane before the lens: for how many "
           "seconds it has rained on it, and the camera's speed ahead in m/s, at which drops "
           "come."),
    option("wiper", float, "A wiper clears the glass every so many seconds since it began to rain "
           "on it; with --glass.", "SECONDS", shows="none"),
)
shutter_option = option(
    "shutter-samples", click.IntRange(1, 256), "Blur what moves, and all of it with a moving "
    "camera: the mean of N pictures over the exposure. Falling drops are blurred without it.", "N",
    default=1)

range_option = option(
    "frame-range", FrameRange(), "Only frames A to B, B excluded; the water is still simulated "
    "from frame 0 on.", shows="all")
shared_range_option = option(
    "frame-range", FrameRange(), "Only frames A to B, B excluded. Other processes, here or on "
    "other machines, may draw other ranges of the same run into the same folder; who finishes its "
    "last frame completes it. A frame has one owner: with --resume what an ended process left "
    "undone is drawn.", shows="all")
farm_options = group(
    option("workers", click.IntRange(1, 4096), "Draw in N processes on this machine, each with its "
           "share of the cores, or a GPU of its own (needs rainsim[farm]).", "N"),
    option("scheduler", str, "Draw by the workers of a dask scheduler, such as tls://host:8786 "
           "(needs rainsim[farm]).", "ADDRESS"),
)
# fmt: on


def output_options(default):
    """Return the options of a command that fills a folder; `default` is shown for --out."""
    return group(
        option("out -o", FOLDER, "Output folder.", "DIR", shows=default),
        option("overwrite", bool, "Allow a folder that is not empty; only earlier results that its "
               "record lists are replaced."),
        threads_option,
        json_option,
        quiet_option,
    )  # fmt: skip


# fmt: off
resume_option = option(
    "resume", bool, "Go on with an unfinished run in the output folder: frames and states that are "
    "finished are kept after a check. Anything but the very same run is refused.")
backend_option = option(
    "backend", click.Choice(["cpu", "cuda"]), "What computes: cuda needs an NVIDIA GPU and "
    "rainsim[cuda]; see `rainsim doctor`.", default="cpu")
quiet_option = option("quiet -q", bool, "Print errors only.")
verbose_option = option("verbose -v", bool, "Say everything that was found and chosen.")
help_all_option = option("help-all", bool, "Show every option.", is_eager=True, expose_value=False,
                         callback=_show_all)
json_option = option("json as_json", bool, "Print results as JSON.")
threads_option = option("threads", int, "Number of threads.", "N", shows="all cores")
run_options = group(
    under("scene", preset_option, scene_option, ground_options, terrain_options,
          ground_map_option, mask_options),
    under("rain", rain_options),
    under("look", light_options),
    under("camera", camera_options, optics_options, shutter_option),
    under("output", picture_options, resume_option, output_options("rainsim-out/SCENE-PRESET"),
          verbose_option, help_all_option),
    big_options, backend_option, shared_range_option, farm_options,
)
# fmt: on


def echo(result, as_json, text):
    """Print a command's result: plain values as JSON, or the text that stands for them."""
    click.echo(json.dumps(result, indent=1) if as_json else text)


def default_out(*names):
    """Return the output folder when none was given."""
    return Path("rainsim-out") / "-".join(plain(name) for name in names)


def plain(name):
    """Return a name with characters replaced that do not belong in a folder's name."""
    return "".join(c if c.isalnum() or c in "._-" else "-" for c in name).strip(".-") or "scene"
