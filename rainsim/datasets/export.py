"""Writes a data set: each picture with its labels is a part that an interrupted export keeps."""

import importlib
import re
import sys
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from rainsim.datasets import LAYOUTS, OPENCV_LENSES, beside
from rainsim.datasets.card import card_of, card_text
from rainsim.datasets.data_files import TEXT, DataFile, write_file, write_files
from rainsim.datasets.sample import Cloud
from rainsim.errors import ParameterError
from rainsim.io.files import write_json
from rainsim.output_folder.card_folder import CardFolder
from rainsim.output_folder.facts import input_facts, versions

CARD, CARD_TEXT, JOURNAL = "card.json", "CARD.md", "pictures.jsonl"
AHEAD = 1  # samples that may wait for their files beside the one that is drawn
PART = r"[\w+-][\w.+-]*"
OURS = re.compile(rf"{PART}(/{PART})*")  # names that lead nowhere but below the folder


def layout_of(name):
    """Return the module of a layout by its name."""
    if name not in LAYOUTS:
        raise ParameterError(f"layout is {name!r}; it must be one of {', '.join(LAYOUTS)}")
    return importlib.import_module(f"rainsim.datasets.{name}")


def check_lenses(views, layout):
    """Raise ParameterError unless a layout has a name for the lenses of views."""
    for view in views:
        if view.lens is not None and view.lens.model in ("division", "eucm"):
            if layout in OPENCV_LENSES:
                raise ParameterError(
                    f"the lens is {view.lens}; in the layout {layout} it must be opencv or "
                    "fisheye; give that, or take --layout colmap"
                )


def _is_ours(name):
    return OURS.fullmatch(name) is not None


class DataSetFolder(CardFolder):
    """A folder that a data set is written to.

    `content` holds plain JSON values that the files depend on.
    """

    def __init__(self, folder, layout, plan, content, scene, resume=False, overwrite=False):
        super().__init__(folder, CARD, JOURNAL, _is_ours, "data set", overwrite, resume)
        self.name, self.plan, self.scene, self.layout = layout, plan, scene, layout_of(layout)
        self._start = time.perf_counter()
        self.find_kept({"data set": content, "layout": layout}, self.count)

    @property
    def count(self):
        """Number of parts: pictures of each rain."""
        return len(self.plan.rates) * len(self.plan.parts)

    def part(self, rate, view):
        """Return the number of the part of a rain's view."""
        return self.plan.rates.index(rate) * len(self.plan.parts) + view

    def missing(self, rate):
        """Return the views of a rain that are to be drawn."""
        return [v for v in range(len(self.plan.parts)) if self.part(rate, v) not in self.kept]

    def begin(self, config_of):
        """Remove what is not kept of an earlier data set, and write the card."""
        self.clear()
        self._card = {
            "program": "rainsim", "command": ["rainsim", *sys.argv[1:]],
            "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"), "versions": versions(),
            "input": input_facts(self.scene, self.folder),
            **card_of(self.plan, self.name, self.scene, config_of), "fingerprint": self.fingerprint,
        }  # fmt: skip
        self._write_card(complete=False)

    def write(self, sample):
        """Write a sample's files, in any thread, and return their names."""
        if isinstance(sample, Cloud):
            files = getattr(self.layout, "cloud_files", beside.cloud_files)(sample, self.plan)
        else:
            files = [*self.layout.sample_files(sample, self.plan),
                     *beside.sample_files(sample, self.plan)]  # fmt: skip
        same = {}
        for file in files:
            same.setdefault((file.kind, id(file.content)), []).append(file)
        # PNGs are packed outside the interpreter's lock, each on a core of its own.
        with ThreadPoolExecutor() as pool:
            list(pool.map(partial(write_files, self.folder), same.values()))
        return [file.name for file in files]

    def note(self, sample, names):
        """Note a sample as finished whose files are whole."""
        part = self.part(sample.rate, sample.view.index)
        self.journal.add(part, names, rain=sample.rate, view=sample.view.name)
        self.kept[part] = names

    def finish(self):
        """Write what belongs to the whole data set, and the card as complete."""
        own = getattr(self.layout, "plan_files", lambda plan, folder: ())
        files = [*own(self.plan, self.folder), *beside.plan_files(self.plan)]
        names = [write_file(self.folder, file) for file in files]
        names.append(write_file(self.folder, DataFile(CARD_TEXT, TEXT, card_text(self._card))))
        self._write_card(complete=len(self.kept) == self.count, files=sorted(names))

    def _write_card(self, complete, **facts):
        seconds = round(time.perf_counter() - self._start, 3)
        facts = {**self._card, "complete": complete, "seconds": seconds, **facts}
        write_json(self.card_file, facts)


def export(shots, folder, config_of, tell=None):
    """Draw and write all samples that are missing in a `DataSetFolder`.

    config_of(rate) gives the settings of a rain rate [mm/h]; tell(stage, done, total) is called.
    A sample is written while the next one is drawn; the first that could not be raises its error.
    """
    folder.begin(config_of)
    drawn = (s for rate in folder.plan.rates for s in shots.draw(rate, folder.missing(rate)))
    waiting = deque()  # samples in their order, and what writes them

    def note_first():
        sample, written = waiting.popleft()
        folder.note(sample, written.result())
        if tell is not None:
            tell("pictures", len(folder.kept), folder.count)

    with ThreadPoolExecutor(1) as writer:
        try:
            for sample in drawn:
                waiting.append((sample, writer.submit(folder.write, sample)))
                if len(waiting) > AHEAD:
                    note_first()
            while waiting:
                note_first()
        finally:  # of an error or an interrupt: what else was drawn stays
            for sample, written in waiting:
                if written.exception() is None:
                    folder.note(sample, written.result())
    folder.finish()


def safe_names(cameras):
    """Return names for files from the cameras' names: letters, digits, -, _; each another."""
    names = []
    for index, camera in enumerate(cameras):
        stem = re.sub(r"\.(png|jpe?g|JPE?G|PNG)$", "", camera.name or "")
        name = re.sub(r"[^\w-]+", "_", stem, flags=re.ASCII).strip("_") or f"view_{index:05d}"
        name = name if name[0] != "-" else f"v{name}"
        while name in names:  # as may be what was made of another's name
            name = f"{name}_{index:05d}"
        names.append(name)
    return names
