"""The command line: parse, call one library function, print. Heavy imports wait in the commands.

Exit codes: 0 done, 1 the run failed, 2 wrong usage or values, 130 interrupted.
"""

import atexit
import errno
import gc

import click

from rainsim import __version__
from rainsim.commands import doctor, export, film, flow, heightmap, lidar, splat, tools, view, world
from rainsim.commands.status import interrupts_remembered
from rainsim.errors import ParameterError, RainsimError, one_line
from rainsim.io.allocator import share_heaps

_FULL = "; make room there or give another --out, and run it again"
_CLOSED = "; give another --out, or change the permissions"
_LOST = "; see that its disk is there, and run the same command again"
REMEDIES = {
    errno.ENOSPC: _FULL, errno.EDQUOT: _FULL, errno.EROFS: _CLOSED, errno.EACCES: _CLOSED,
    errno.ESTALE: _LOST, errno.EIO: _LOST, errno.ENOTCONN: _LOST, errno.ETIMEDOUT: _LOST,
    errno.EMFILE: "; raise the number of open files (ulimit -n)",
}  # fmt: skip
INTERRUPTED = 130  # 128 + SIGINT, as shells have it


class Commands(click.Group):
    """A group that turns the errors which a user can meet into one line and an exit code."""

    def invoke(self, ctx):
        """Run the chosen command; end with one line and an exit code where it raises an error.

        click's own errors keep click's exit codes.
        """
        try:
            with interrupts_remembered():
                return super().invoke(ctx)
        except ParameterError as error:
            raise _failure(error, 2) from error
        except RainsimError as error:
            raise _failure(error, 1) from error
        except click.ClickException as error:  # its message repeats what was typed
            error.message = one_line(str(error.message))
            raise
        except BrokenPipeError:  # the reader of our output has gone: click ends quietly
            raise
        except OSError as error:
            where = f"{error.filename}: " if error.filename else ""
            remedy = REMEDIES.get(error.errno, "")
            raise _failure(f"{where}{error.strerror or error}{remedy}", 1) from error
        except MemoryError as error:
            raise _failure(
                "there is not enough memory; use a larger --spacing, a smaller --width or a "
                "smaller capture",
                1,
            ) from error
        except KeyboardInterrupt:
            click.echo("\ninterrupted; what was finished is kept", err=True)
            ctx.exit(INTERRUPTED)

    def list_commands(self, ctx):
        """Return the commands in the order in which they are used."""
        return list(self.commands)


def _failure(message, code):
    failure = click.ClickException(one_line(str(message)))
    failure.exit_code = code
    return failure


@click.group(
    cls=Commands,
    context_settings={
        "help_option_names": ["-h", "--help"],
        "max_content_width": 100,
    },
)
@click.version_option(__version__, prog_name="rainsim")
def cli():
    """Physically right, good-looking rain in captured 3D Gaussian Splatting scenes.

    \b
    Example:
        rainsim run                                   a downpour on the built-in bicycle
        rainsim run my-capture --preset downpour --orbit --video
    """


for _command in (
    film.run,
    tools.import_,
    heightmap.heightmap,
    film.simulate,
    film.render,
    splat.splat,
    export.export,
    world.world,
    lidar.lidar,
    flow.flow,
    view.view,
    tools.scenes,
    tools.presets,
    tools.warmup,
    doctor.doctor,
):
    cli.add_command(_command)


def main():
    """Run the command line; the entry of `rainsim` and of `python -m rainsim`."""
    share_heaps()
    atexit.register(gc.freeze)  # else Python looks through all objects again before it ends
    cli(prog_name="rainsim")
