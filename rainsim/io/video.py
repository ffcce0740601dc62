"""Videos: frames as H.264, H.265 or ProRes, by an FFmpeg that runs as a program of its own.

The only module that imports imageio_ffmpeg. A quality from 0 to 100 means the same for H.264 and
H.265, the constant rate factor 51 - quality / 2 (0 is nearly lossless, 51 the worst). ProRes has a
quantiser from 1 to 64 in its place, which a step of 100 / 6 halves.
"""

import os
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rainsim.errors import RainsimError
from rainsim.io.files import put_in_place

WORST_CRF = 51.0
WORST_STEP = 64  # of ProRes's quantiser; FFmpeg takes no more
# Players take a video without these marks for BT.601 or BT.709, by its size; so we say which.
COLORS = (
    "-vf", "scale=out_color_matrix=bt709:flags=bicubic+accurate_rnd+full_chroma_int",
    "-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709",
    "-color_range", "tv",
)  # fmt: skip


def _crf(quality):
    return "-crf", f"{WORST_CRF - quality / 2:g}"


def _quantiser(quality):
    return "-qscale:v", str(round(WORST_STEP ** (1 - quality / 100)))


class Codec(NamedTuple):
    """How FFmpeg is asked for a codec."""

    encoder: str
    suffix: str  # of the file
    pixels: str  # FFmpeg's name of how they are stored
    rate: object  # rate(quality) returns the options of a quality
    usual: tuple  # the options without one
    more: tuple = ()


CODECS = {
    "h264": Codec("libx264", ".mp4", "yuv420p", _crf, ()),
    "h265": Codec(  # Apple's players want the tag; x265 would print a page about itself
        "libx265", ".mp4", "yuv420p", _crf, _crf(70),
        ("-tag:v", "hvc1", "-x265-params", "log-level=error"),
    ),
    "prores": Codec(  # 422 HQ, at the rate that Apple states unless a quality is given
        "prores_ks", ".mov", "yuv422p10le", _quantiser, (),
        ("-profile:v", "3", "-vendor", "apl0"),
    ),
}  # fmt: skip


class VideoFormat(NamedTuple):
    """Codec and quality of a video."""

    codec: str = "h264"  # of `CODECS`
    quality: float | None = None  # from 0 to 100; None for what is usual for the codec
    start: int = 0  # number of the first frame, which the time code has; at 0 there is none

    @property
    def name(self):
        """Of the file, str."""
        return "video" + CODECS[self.codec].suffix

    @property
    def settings(self):
        """The arguments for the function of imageio_ffmpeg that writes frames, dict."""
        codec = CODECS[self.codec]
        if self._replace(start=0) == USUAL:
            return {"codec": codec.encoder, "quality": 8}
        rate = codec.usual if self.quality is None else codec.rate(self.quality)
        more = [*rate, *codec.more, *COLORS]
        return {
            "codec": codec.encoder, "quality": None, "pix_fmt_out": codec.pixels,
            "output_params": more,
        }  # fmt: skip


USUAL = VideoFormat()


def time_code(frame, fps):
    """Return a frame's time code without drop frames: 1001 at 24/s is 00:00:41:17."""
    whole = max(round(fps), 1)
    seconds, left = divmod(frame, whole)
    return f"{seconds // 3600 % 24:02}:{seconds // 60 % 60:02}:{seconds % 60:02}:{left:02}"


def require_video(video=USUAL):
    """Raise RainsimError unless such videos can be written; to be asked before the first frame."""
    program = _ffmpeg().get_ffmpeg_exe()
    there = _encoders(program)
    if CODECS[video.codec].encoder not in there:
        known = ", ".join(name for name, codec in CODECS.items() if codec.encoder in there)
        raise RainsimError(
            f"--video-codec {video.codec} needs the encoder {CODECS[video.codec].encoder}, which "
            f"{program} lacks; it has those of: {known or 'no codec that rainsim writes'}; give "
            "another --video-codec, or name another FFmpeg in IMAGEIO_FFMPEG_EXE"
        )


def _ffmpeg():
    try:
        import imageio_ffmpeg  # an extra: 70 MB that most runs do not need

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        raise RainsimError(
            "a video was asked for and no video encoder is installed; "
            'pip install "rainsim[video]" brings one, or leave out --video'
        ) from None
    return imageio_ffmpeg


def _encoders(program):
    """Return the names of the encoders that an FFmpeg has: a set of str."""
    command = [program, "-hide_banner", "-encoders"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    except OSError as error:
        raise RainsimError(
            f"the video encoder {program} cannot be run ({error.strerror}); a video needs FFmpeg; "
            "name another in IMAGEIO_FFMPEG_EXE, or leave out --video"
        ) from None
    rows = (line.split() for line in done.stdout.splitlines())
    return {row[1] for row in rows if len(row) > 1 and row[0].startswith("V")}


class VideoWriter:
    """Writes frames to a video file as they come; use as a context manager.

    The file, whose name ends as `video` says, is replaced when the block ends, also when it ends
    early with frames written; it is removed if there were none.
    """

    def __init__(self, path, fps, video=USUAL):
        self._module = _ffmpeg()
        self.path, self._fps, self._format = Path(path), fps, video
        self._sender, self._temporary = None, None

    def __enter__(self):
        handle, name = tempfile.mkstemp(
            prefix=f".{self.path.name}.", suffix=self.path.suffix, dir=self.path.parent
        )
        os.close(handle)
        self._temporary = Path(name)
        return self

    def add(self, image):
        """Append a frame, an ndarray of shape (height, width, 3), uint8."""
        # The usual chroma needs even sides: repeat the last line, do not rescale.
        height, width = image.shape[:2]
        image = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        if self._sender is None:
            settings = self._format.settings
            if self._format.start > 0:
                code = "-timecode", time_code(self._format.start, self._fps)
                settings["output_params"] = [*settings.get("output_params", ()), *code]
            self._sender = self._module.write_frames(
                str(self._temporary),
                (image.shape[1], image.shape[0]),
                fps=self._fps,
                macro_block_size=2,
                ffmpeg_log_level="error",
                **settings,
            )
            self._sender.send(None)
        self._sender.send(np.ascontiguousarray(image))

    def __exit__(self, *exception):
        try:
            if self._sender is not None:
                self._sender.close()
                put_in_place(self._temporary, self.path)
        finally:
            self._temporary.unlink(missing_ok=True)
