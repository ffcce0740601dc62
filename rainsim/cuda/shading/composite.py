"""Twin of `rainsim.shading.composite`: the finished picture of 8 bit, a thread for each pixel."""

from rainsim.constants import HALF, ONE
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.numerics.interpolation import bilinear_color
from rainsim.scene.view import column_slope, row_slope
from rainsim.shading import composite


@cuda_kernel
def compose(picture, depth, drops, light, view, brightness, image_out):
    """Put air, splashes and drops before a picture and encode it for display."""
    column, row = cuda.grid(2)
    height, width = depth.shape
    if row >= height or column >= width:
        return
    a = column_slope(view, column)
    b = row_slope(view, row)
    clear = composite.transmittance(drops.fog, depth[row, column], a, b)
    past_splashes, past_drops = (
        ONE - drops.splash_alpha[row, column], ONE - drops.rain_alpha[row, column]
    )  # fmt: skip
    field = light.drops
    u = composite.field_place(column, width, field.shape[1]) + HALF
    v = composite.field_place(row, height, field.shape[0]) + HALF
    shown, around = bilinear_color(field, u, v), bilinear_color(light.around, u, v)
    for c in range(3):
        value = composite.through_rain(
            picture[row, column, c], shown[c], around[c], light.air[c], clear,
            past_splashes, past_drops,
        )  # fmt: skip
        image_out[row, column, c] = composite.eight_bit(composite.tone_curve(value * brightness))
