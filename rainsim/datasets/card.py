"""The card of a data set: what was rained on, how hard, and by which numbers."""

from rainsim import __version__
from rainsim.datasets.data_files import condition
from rainsim.datasets.sample import PARTNERS
from rainsim.drops import Weather
from rainsim.rain.size_distribution import SIZE_LAWS
from rainsim.render.labels import class_names
from rainsim.render.weather import weather_of
from rainsim.sensors.radar import rain_attenuation

VERSION_KEY, VERSION = "rainsim_data_set", 1  # of card.json
RADARS = (24.0, 77.0)  # GHz


def card_of(plan, layout, scene, config_of):
    """Return the card as plain JSON values; config_of(rate) gives the settings of a rate [mm/h]."""
    frame = scene.ground_frame
    lens = plan.views[0].lens
    return {
        VERSION_KEY: VERSION,
        "version": __version__,
        "layout": layout,
        "scene": plan.name,
        "pictures": len(plan.views) * len(plan.rates),
        "width": plan.views[0].camera.width,
        "height": plan.views[0].camera.height,
        "views": [view.name for view in plan.views],
        "held_out": [view.name for view in plan.views if view.held_out],
        "sequence": plan.sequence,
        **({} if plan.rig is None else {"rig": plan.rig.facts(), "turns": len(plan.turns)}),
        "lens": None if lens is None else {"model": lens.model, "values": list(lens.values)},
        "classes": class_names(),
        "partners": {name: PARTNERS[name] for name in plan.partners},
        "world": "ground frame: metres, right-handed, z up",
        "meters_per_unit": frame.meters_per_unit,
        "scale_assumed": frame.scale_assumed,
        "rains": [rain_facts(rate, config_of(rate)) for rate in plan.rates],
    }


def rain_facts(rate, config):
    """Return what the card says of one rain: its folder, weather and radar attenuation."""
    now = config.at(0.0)
    field = Weather(config).field(0.0, now.render.exposure)
    radar = {f"{f:g}_ghz": round(float(rain_attenuation(rate, f)), 4) for f in RADARS}
    return {
        "rain_mm_per_hour": rate, "folder": condition(rate), **weather_of(now, field),
        "radar_db_per_km_vertical": radar,
    }  # fmt: skip


def card_text(card):
    """Return the card for people, as Markdown."""
    lines = [
        f"# {card['scene']}: {card['pictures']} pictures in the layout of {card['layout']}",
        "",
        f"Made by rainsim {card['version']}. {card['width']} x {card['height']} px; "
        f"{len(card['views'])} views, {len(card['held_out'])} of them held out; "
        + ("they follow one another in time." if card["sequence"] else "all see one moment."),
        "",
        "| rain mm/h | folder | optical range m | extinction 1/m | drops N0 1/m4, decay 1/m "
        "| past rain mm | wetness of paving | exposure ms | sun | seed | 77 GHz dB/km |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for rain in card["rains"]:
        drops = rain["drops"]
        spectrum = "none"
        if drops is not None:
            spectrum = f"{drops['intercept_per_m4']:.3g}, {drops['decay_per_m']:.4g}"
        sun = rain["sun_degrees"]
        shown = ", ".join(f"{v:g}" for v in sun) if isinstance(sun, list) else sun or "none"
        lines.append(
            f"| {rain['rain_mm_per_hour']:g} | `{rain['folder']}` "
            f"| {rain['optical_range_m'] or 'clear'} | {rain['extinction_per_m']:.3g} "
            f"| {spectrum} | {rain['past_rain_mm']:g} | {rain['wetness_of_paving']:g} "
            f"| {rain['exposure_s'] * 1e3:.4g} | {shown} | {rain['seed']} "
            f"| {rain['radar_db_per_km_vertical']['77_ghz']:g} |"
        )
    if card["partners"]:
        lines += ["", "Partners of each rainy picture, in `rainsim` of its rain:", ""]
        lines += [f"- `{name}`: {text}" for name, text in card["partners"].items()]
    assumed = " (assumed)" if card["scale_assumed"] else ""
    lines += [
        "",
        f"World: {card['world']}; {card['meters_per_unit']:.6g} m a unit of the capture{assumed}. "
        f"{drop_law(card['rains'])}Radar: ITU-R P.838-3, vertical, one way. Clear is the dry "
        "capture as it was taken.",
        "",
    ]
    return "\n".join(lines)


def drop_law(rains):
    """Return a sentence on the sizes of drops in some rains, see `rain_facts`; none without any."""
    for rain in rains:
        if rain["drops"] is not None:
            law, radii = rain["drops"]["law"].replace("intercept", "N0"), rain["drops"]["radii"]
            source = SIZE_LAWS[radii](rain["rain_mm_per_hour"]).source
            return f"Drops: {law}, {source} with N0 renormalised to the rate. "
    return ""
