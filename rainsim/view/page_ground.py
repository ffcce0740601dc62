"""The page's tools on the ground: read a point, measure, set scale and up, paint, flood."""

import threading

import numpy as np

from rainsim.errors import ParameterError
from rainsim.scene.folder import override_ground_frame
from rainsim.terrain.poured import DRAINS, STAYS, painted_water
from rainsim.terrain.table import class_table
from rainsim.view import probe

READ, MEASURE, UP, PAINT, POUR = "read", "measure", "up", "paint", "pour"
TOOLS = {
    READ: "read a point", MEASURE: "measure: two points", UP: "up: three points",
    PAINT: "paint a class", POUR: "put water",
}  # fmt: skip
POINTS = {READ: 1, MEASURE: 2, UP: 3, PAINT: 1, POUR: 1}
BRUSHES = PAINT, POUR
LEFT = "leave to the program"
SOME_SIZE = 300, 200  # px, of cameras whose place alone matters
MARK = 0.02  # m, radius of the mark of a clicked point


class GroundTools:
    """The actions of clicks into the picture, the same on all pages."""

    def __init__(self, page):
        self.page, self.painter = page, page.painter
        self.points, self._marks, self._plot = [], [], None
        self._eye = None  # from where the last point was seen
        self._count = 0  # of all marks: a name is used once
        self._lock = threading.Lock()  # each callback has a thread of its own
        gui = page.server.gui
        with gui.add_folder("Ground", order=4, expand_by_default=False) as self._folder:
            self.tool = gui.add_dropdown("a click", tuple(TOOLS.values()))
            self.answer = gui.add_markdown("click on the picture")
            self.length = gui.add_number("known length [m]", 1.0, min=1e-3, max=1e4, step=0.01)
            self.scale = gui.add_button("set the scale by this length", disabled=True)
            self.up = gui.add_button("set up by these points", disabled=True)
            names = (*class_table().names, LEFT)
            self.kind = gui.add_dropdown("class", names)
            self.radius = gui.add_slider("brush [m]", 0.05, 3.0, 0.05, 0.3)
            self.depth = gui.add_slider("water put [mm]", 0, 200, 1, 10)
            self.use = gui.add_dropdown("the water", (STAYS, DRAINS))
            self.flood = gui.add_button("flood up to the point", disabled=True)
            for label, what in (
                ("save ground and classes", "save_ground"),
                ("save as a scene of its own", "save_scene"),
            ):
                save = gui.add_button(label)
                save.on_click(page.guarded(lambda _, what=what: self._save(what)))
        self.tool.on_update(self._choose_tool)
        self.kind.on_update(self._say_brush)
        for control in (self.radius, self.depth, self.use):
            control.on_update(self._say_brush)
        self.scale.on_click(page.guarded(self._set_scale))
        self.up.on_click(page.guarded(self._set_up))
        self.flood.on_click(page.guarded(self._flood))

    def connect(self, handle):
        """Take the clicks of a new page."""
        handle.scene.on_click()(self.page.guarded(self._click))

    @property
    def chosen(self):
        """The key of the tool that is chosen."""
        return next(key for key, label in TOOLS.items() if label == self.tool.value)

    def _choose_tool(self, event):
        with self._lock:
            self._forget()
        self._say_brush(event)

    def _say_brush(self, event):
        """Say what the next click paints or puts, and how wide."""
        radius = float(self.radius.value)
        if self.chosen == PAINT:
            self.answer.content = f"a click paints {self.kind.value} within {radius:.2f} m"
        elif self.chosen == POUR:
            put = f"{self.depth.value:g} mm of water that {self.use.value}"
            self.answer.content = f"a click puts {put} within {radius:.2f} m"

    def _click(self, event):
        view = self.page.viewpoint_of(event)
        size = self.page.clients[event.client.client_id].size
        if not size[0]:
            return
        place, tool = event.screen_pos, self.chosen
        index = self.painter.clock.index

        def look(session):
            point = probe.point_at(session, view, place, size)
            reading = probe.read_point(session, point, index)
            history = None
            if reading.cell is not None:
                history = session.water.depths_at(*reading.cell)
            return reading, history

        reading, history = self.painter.ask(look).result()
        with self._lock:
            if self.chosen != tool:  # another tool was chosen meanwhile
                return
            self._take(reading, history, tool, view)
        if tool in BRUSHES and reading.cell is None:
            raise ParameterError("no map lies there; brushes work on its ground; click on it")
        if tool in BRUSHES:
            (self._paint if tool == PAINT else self._pour)(reading.point)

    def _take(self, reading, history, tool, view):
        """Take a clicked point for the chosen tool, and show its reading."""
        if len(self.points) >= POINTS[tool]:
            self._forget()
        self.points.append(reading.point)
        self._eye = view.position
        self._mark(reading.point)
        self.answer.content = "\n\n".join(self._words(reading))
        if history is not None and tool == READ:
            self._show_history(*history)
        self.scale.disabled = not (tool == MEASURE and len(self.points) == 2)
        self.up.disabled = not (tool == UP and len(self.points) == 3)
        self.flood.disabled = reading.cell is None

    def _words(self, reading):
        """Return the text on the points that were clicked, lines."""
        lines = reading.lines()
        if self.chosen == MEASURE and len(self.points) == 2:
            a, b = (np.array(point) for point in self.points)
            lines.insert(0, f"**{np.linalg.norm(b - a):.3f} m** between the points")
        elif len(self.points) < POINTS[self.chosen]:
            lines.append(f"{POINTS[self.chosen] - len(self.points)} more to click")
        return lines

    def _mark(self, point):
        name, self._count = f"/points/{self._count}", self._count + 1
        self._marks.append(
            self.page.server.scene.add_icosphere(
                name, radius=MARK, color=(255, 60, 60), position=point
            )
        )
        self.page.use_depth()

    def _forget(self):
        """Forget the clicked points, with the lock held."""
        for mark in self._marks:
            mark.remove()
        self.points, self._marks = [], []
        self.scale.disabled = self.up.disabled = self.flood.disabled = True

    def _show_history(self, times, depths):
        """Plot the water over time at a point."""
        if self._plot is not None:
            self._plot.remove()
            self._plot = None
        if len(times) < 2:
            return
        with self._folder:
            self._plot = self.page.server.gui.add_uplot(
                (times, depths * 1e3), ({"label": "s"}, {"label": "mm", "stroke": "#56b4e9"}),
                height=160, scales={"x": {"time": False}},
            )  # fmt: skip

    # --- what is mended ---------------------------------------------------------------------------

    def _set_scale(self, event):
        a, b = self.points
        length = float(self.length.value)

        def rescale(session):
            scale = probe.meters_per_unit_of(session.scene, a, b, length)
            session.set_scene(override_ground_frame(session.scene, meters_per_unit=scale))
            return f"scale: {scale:.6g} m per capture unit"

        self._mend(rescale)

    def _set_up(self, event):
        points, eye = list(self.points), self._eye

        def turn(session):
            up = probe.up_of(session.scene, points, eye)
            scene, is_found = probe.with_up(session.scene, up, points[0])
            session.set_scene(scene)
            shown = ", ".join(f"{v:.5f}" for v in scene.ground_frame.up)
            how = "the ground nearest to it is level" if is_found else "no ground was found by it"
            return f"up: {shown} of the capture; {how}"

        self._mend(turn)

    def _mend(self, change):
        """Let the drawing thread change the scene; keyframes keep their place in it."""
        clients = {k: c for k, c in self.page.clients.items() if c.view is not None}
        before = [
            *(client.view for client in clients.values()),
            *(k.view for k in self.page.home.keyframes.keyframes),
        ]

        def work(session):
            cameras = [session.camera_of(view, *SOME_SIZE) for view in before]
            found = change(session)
            return found, [session.viewpoint_of(camera) for camera in cameras]

        found, views = self.painter.ask(work).result()
        with self._lock:
            self._forget()
        self.answer.content = found
        for client, view in zip(clients.values(), views[: len(clients)], strict=True):
            self.page.turn(client, view)
        self.page.home.keyframes.move(views[len(clients) :])
        self.painter.redraw()

    def _paint(self, point):
        name, radius = self.kind.value, float(self.radius.value)
        code = -1 if name == LEFT else class_table().names.index(name)

        def paint(session):
            mask = probe.painted(session.class_mask, session.terrain, point, radius, code)
            session.set_scene(session.scene, mask)

        self.painter.ask(paint).result()
        self.painter.redraw()

    def _pour(self, point):
        radius, depth = float(self.radius.value), 1e-3 * float(self.depth.value)
        stays = self.use.value == STAYS

        def pour(session):
            grid = session.terrain.grid
            mask = painted_water(session.water_mask, grid, point, radius, depth, stays)
            session.set_water_mask(mask)

        self.painter.ask(pour).result()
        self.painter.redraw()

    def _flood(self, event):
        if not self.points:
            raise ParameterError("no point is chosen; click on the picture first")
        height = self.points[-1][2]

        def level(session):
            from rainsim.water.puddles import low_ground

            return height - low_ground(session.terrain)

        value = self.painter.ask(level).result()
        self.page.settings.change({"level": round(float(value), 4)})
        self.page.settings.show_config(self.painter.config)

    def _save(self, what):
        home = self.page.home.home
        taken = self.painter.ask(getattr(home, what)).result()
        self.answer.content = f"saved in `{taken.folder}`\n\n`{taken.line}`"
