"""The registry of the methods: a row is all that a method needs, and loading one never trains."""

import io
import shutil
import subprocess
import sys

import pandas as pd
import pytest
import runs
from matplotlib.text import Text
from PIL import Image

from deepmds_keras import InputError
from experiments.figures import style
from experiments.inputs import load_faces
from experiments.method import Method
from experiments.methods import METHODS, load, methods_of
from experiments.presets import TINY
from experiments.report import report
from experiments.run import Run
from experiments.tracks import predictions
from experiments.tracks.bfm import bfm
from experiments.tracks.networks import chains


class Scaled:
    """The mean shape, a little too large."""

    n_parameters = 216

    def __init__(self, run):
        self.shape = 1.01 * load_faces(run, "train").shapes.mean(0)

    def predict(self, views):
        return self.shape[None].repeat(len(views), 0)


MADE_UP = Method(
    id="made_up",
    title="Made up",
    description="the mean shape, a little too large",
    tracks=("bfm",),
    load=Scaled,
    mapped=("bfm",),
    complexity="O(n)",
)


@pytest.fixture
def written(monkeypatch):
    """Names of the figures that are saved, and the words in each."""
    figures, words, picture = {}, [], io.BytesIO()
    Image.new("RGB", (9, 9)).save(picture, "png")

    def small_png(figure):
        words[:] = [text.get_text().replace("\n", " ") for text in figure.findobj(Text)]
        return picture.getvalue()

    def write_bytes(path, content):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        figures[path.stem] = [*words]

    monkeypatch.setattr(style, "_small_png", small_png)
    monkeypatch.setattr(style, "_render", lambda *_, **__: b"pdf")
    monkeypatch.setattr(style, "write_bytes", write_bytes)
    return figures


def test_a_row_is_all_that_a_method_needs(whole_bfm, tmp_path, monkeypatch, written):
    monkeypatch.setitem(METHODS, MADE_UP.id, MADE_UP)
    for name in ("build", "results"):
        shutil.copytree(whole_bfm.folder / name, tmp_path / name)
    results = ["--preset", TINY.name, "--results", str(tmp_path / "results")]
    for stage in (predictions, bfm):
        stage.main([*results, "--build", str(tmp_path / "build"), "--jobs", "1"])
    folder = runs.results(tmp_path, "")
    for name in ("metrics.csv", "table.csv"):
        rows = pd.read_csv(folder / "bfm" / name).set_index(["method", "metric"]).sort_index()
        column = "value" if name == "metrics.csv" else "mean"
        own, other = (rows.loc[(m, "mse"), column].mean() for m in ("made_up", "mean_shape"))
        assert own == pytest.approx(other, rel=1e-3), name  # the alignment takes the scale out
    assert "Made up" in (folder / "bfm/table.tex").read_text(encoding="utf-8")
    assert "Made up & 216" in (folder / "parameters/table.tex").read_text(encoding="utf-8")
    for name in ("summary", "qualitative", "error_per_landmark", "error_per_pose"):
        assert "Made up" in written[name], name

    report.main(results)
    assert "Made up" in (folder / "report/index.html").read_text(encoding="utf-8")


def test_loading_never_trains(whole_bfm, tmp_path):
    """The error names the stage to run."""
    shutil.copytree(whole_bfm.folder / "build", tmp_path / "build")
    run = Run("openhead", TINY, build=tmp_path / "build", jobs=1)
    before = {path: path.stat().st_mtime_ns for path in run.networks.iterdir()}
    trained = [m.id for m in METHODS.values() if m.train and "bfm" in m.tracks]
    for method in trained:
        load(run, method)
    assert {path: path.stat().st_mtime_ns for path in run.networks.iterdir()} == before
    shutil.rmtree(run.networks)
    for method in trained:
        stage = "mobileface" if method == "mobileface" else "networks"
        with pytest.raises(InputError, match=f"does not exist.*stage {stage} .make reproduce-bfm"):
            load(run, method)
    assert not run.networks.exists()


def test_methods_that_share_a_network_are_trained_in_one_process():
    of = {track: chains(Run("openhead", TINY, track=track)) for track in ("bfm", "flame")}
    for own in of.values():
        assert len(own) == 2  # as many processes as the smallest machine has cores
        assert own[0] == ["ours", "ours_released"]  # of one autoencoder
    assert sum(of["bfm"], []) == [
        *("ours", "ours_released", "zhao", "zhao_authors", "ours_stable", "lifting")
    ]


def test_a_method_is_run_where_its_row_says():
    def ids(**parameters):
        run = Run("openhead", TINY, **parameters)
        return [method.id for method in methods_of(run, "predictions")]

    assert "aldrian" in ids() and "aldrian" not in ids(track="flame")
    assert "authors_weights" not in ids() and "authors_weights" in ids(authors="folder")
    everywhere = {m.id for m in METHODS.values() if m.load and m.stage is None}
    assert not everywhere


def test_every_look_is_its_own():
    looks = [(m.colour, m.marker) for m in METHODS.values() if m.drawn]
    assert len({*looks}) == len(looks) == len({colour for colour, _ in looks})


def test_the_registry_loads_no_framework():
    code = (
        "import sys, experiments.methods, experiments.figures.style;"
        "sys.exit(bool({'tensorflow', 'keras', 'sklearn'} & sys.modules.keys()))"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
