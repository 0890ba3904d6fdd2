"""What the documents name is there, and what they say of the code is so."""

import ast
import contextlib
import hashlib
import inspect
import pkgutil
import re
import shutil

import numpy as np
import pandas as pd
import pytest
from faces import mean_landmarks
from places import MEDIAPIPE, ROOT, SHARED, committed, python
from scipy.spatial.distance import pdist

from data_gen.models import basel, flame
from data_gen.models.registry import MODELS
from data_gen.views import PROTOCOLS
from deepmds_keras import (
    build_autoencoder,
    build_dissimilarity_net,
    normalise,
    predict_landmarks,
    predict_photo,
    sample_views,
)
from deepmds_keras.baselines.mobileface import MobileFace, build_mobileface_net
from deepmds_keras.baselines.ringnet import RingNet
from deepmds_keras.baselines.zhao import Zhao, build_zhao_net
from deepmds_keras.errors import InputError
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.networks import count_trainable
from deepmds_keras.tool.detection.dlib_landmarks import find_shape_predictor
from deepmds_keras.training import Recipe
from docs import make_docs
from docs.make_docs import Results, pages
from experiments.presets import FULL, PRESETS
from experiments.recipes import MOBILEFACE_FILES, MOBILEFACE_RATES, ZHAO_FILES
from experiments.records import write_json
from experiments.run import AUTHORS_FILES, EVALUATORS

FOLDER = committed().resolve()
PAGES = [FOLDER / "README.md", FOLDER / "THIRD_PARTY_NOTICES.md"]
PAGES += sorted((FOLDER / "docs").glob("*.md"))
TEXTS = pages(Results(FOLDER / "results"))
each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)

_FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.M | re.S)
_MATH = re.compile(r"\$`[^`]*`\$")
_LINK = re.compile(r"\[([^\]]*)\]\(([^)\s]+)\)")
_OF_SEEDS = ("median", "lowest", "highest")
_OTHER_COMMANDS = ("apt ", "git ", "make ", "pip ", "python")
_CHOICES = {"MODEL": MODELS, "PROTOCOL": PROTOCOLS, "EVALUATOR": EVALUATORS, "PRESET": PRESETS}


def text_of(name):
    """A page on one line, as a reader sees it."""
    return " ".join((FOLDER / name).read_text(encoding="utf-8").split())


def prose_of(page):
    return _FENCE.sub("", page.read_text(encoding="utf-8"))


def code_of(page):
    """Pieces of code of a page: those within lines, and the lines of blocks."""
    spans = re.findall(r"`([^`\n]+)`", _MATH.sub("", prose_of(page)))
    blocks = [block for _, block in _FENCE.findall(page.read_text(encoding="utf-8"))]
    return [*spans, *(line.strip() for block in blocks for line in block.splitlines())]


def python_of(page):
    blocks = _FENCE.findall(page.read_text(encoding="utf-8"))
    return [block for language, block in blocks if language == "python"]


def anchors_of(page):
    """What GitHub makes of the headings."""
    headings = re.findall(r"^#+ (.+)$", prose_of(page), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def target_of(page, path):
    """What a link leads to: a document or result as git has it, or a file of the code."""
    target = (page.parent / path).resolve()
    return target if target.exists() else ROOT / target.relative_to(FOLDER)


def names_in(path):
    """What a module defines at its top level, and members of its classes as `Class.member`."""
    names = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            members = (item for item in node.body if isinstance(item, ast.FunctionDef))
            names |= {f"{node.name}.{member.name}" for member in members}
        targets = node.targets if isinstance(node, ast.Assign) else []
        names |= {target.id for target in targets if isinstance(target, ast.Name)}
    return names


@pytest.mark.parametrize("page", TEXTS)
def test_make_docs_would_change_nothing(page):
    assert (FOLDER / page).read_text(encoding="utf-8") == TEXTS[page]


@pytest.fixture
def changed(tmp_path):
    """Pages from a copy of the results, after a change of the main table of the open head."""
    shutil.copytree(FOLDER / "results", tmp_path / "results")

    def changed(change):
        path = tmp_path / "results" / "openhead" / "bfm" / "table.csv"
        change(pd.read_csv(path)).to_csv(path, index=False)
        results = Results(tmp_path / "results")
        return pages(results), results

    return changed


def test_a_run_of_one_seed_is_written_into_the_pages_and_named(changed):
    one, results = changed(lambda table: table.drop(columns=["n_seeds", *_OF_SEEDS]))
    assert results.of_one_seed == {"openhead/bfm"}
    assert "ridge regression" in one["README.md"]


def test_files_that_all_steps_of_a_folder_read_are_listed_too(tmp_path):
    manifest = {"inputs": {"a.npz": "12"}, "steps": [{}, {}]}
    write_json(tmp_path / "folder" / "manifest.json", manifest)
    assert [*Results(tmp_path).files_read("folder")["name"]] == ["a.npz"]


@pytest.mark.parametrize(
    ("value", "text"), [(0.4567, "0.46"), (99.4, "99"), (99.7, "100"), (123.4, "123")]
)
def test_digits_never_become_an_exponent(value, text):
    assert make_docs._significant(value) == text


def test_a_sentence_that_is_no_longer_true_is_named(changed, monkeypatch, tmp_path):
    def mean_shape_is_worse(table):
        of_mean = (table["method"] == "mean_shape") & (table["metric"] == "mse")
        table.loc[of_mean, ["mean", *_OF_SEEDS]] *= 10
        return table

    with pytest.raises(make_docs.UntrueError):
        changed(mean_shape_is_worse)
    monkeypatch.setattr(make_docs, "ROOT", tmp_path)
    shutil.copytree(ROOT / "docs" / "templates", tmp_path / "docs" / "templates")
    with pytest.raises(SystemExit, match=r"README.md.j2:\d+ must be true .*mean_shape"):
        make_docs.main()
    assert not (tmp_path / "README.md").exists()


def test_results_that_are_missing_are_named(changed, monkeypatch, tmp_path):
    (tmp_path / "results" / "openhead" / "bfm" / "manifest.json").unlink()
    monkeypatch.setattr(make_docs, "ROOT", tmp_path)
    shutil.copytree(ROOT / "docs" / "templates", tmp_path / "docs" / "templates")
    with pytest.raises(SystemExit, match=r"Missing: .*manifest\.json not found\.$"):
        make_docs.main()


# Links, paths, names


@each_page
def test_every_link_leads_somewhere(page):
    for _, link in _LINK.findall(_MATH.sub("", prose_of(page))):
        if re.match(r"https?:|\.\./\.\./actions/", link):  # not of the repository's files
            continue
        path, _, anchor = link.partition("#")
        target = target_of(page, path) if path else page
        assert target.exists(), link
        assert not anchor or anchor in anchors_of(target), link


@each_page
def test_every_name_that_links_to_a_module_is_defined_there(page):
    for label, link in _LINK.findall(prose_of(page)):
        name = label.strip("`")
        if link.endswith(".py") and label.startswith("`") and "/" not in name:
            assert name in names_in(target_of(page, link)), f"{name} in {link}"


@each_page
def test_every_path_and_every_name_in_code_is_there(page):
    packages = "deepmds_keras|data_gen|experiments"
    results = "results(?!/(smoke|bfm|flame))"  # but of small presets and of licensed models
    for code in code_of(page):
        if re.fullmatch(rf"({packages}|docs|tests|{results})/[\w./-]*", code):
            assert (ROOT / code).exists(), code
        if re.fullmatch(rf"({packages})(\.\w+)+", code):
            pkgutil.resolve_name(code)  # fails if it is neither a module nor something in one


@each_page
def test_every_target_and_variable_of_make_is_in_the_makefile(page):
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = {*re.findall(r"^([a-z-]+):", makefile, re.M)}
    variables = {*re.findall(r"^([A-Z_]+) \?=", makefile, re.M)}
    for code in code_of(page):
        assert {*re.findall(r"\bmake ([a-z-]+)", code)} <= targets, code
        for variable, value in re.findall(r"(?:^|\s)([A-Z][A-Z_]+)=([\w.-]*)", code):
            assert variable in variables, code
            assert not value or value in _CHOICES.get(variable, [value]), code


def test_every_option_of_the_command_is_one():
    options = set()
    for command in ("predict", "live", "export", "train", "evaluate"):
        done = python("-m", "deepmds_keras", command, "--help")
        assert done.returncode == 0, done.stderr
        options |= {*re.findall(r"--[a-z][a-z-]*", done.stdout)}
    code = [code for page in PAGES for code in code_of(page)]
    ours = [piece for piece in code if not piece.startswith(_OTHER_COMMANDS)]
    assert {name for piece in ours for name in re.findall(r"--[a-z][a-z-]*", piece)} <= options


@each_page
def test_python_in_the_pages_imports_what_exists(page):
    for block in python_of(page):
        kinds = ast.Import | ast.ImportFrom
        imports = [node for node in ast.walk(ast.parse(block)) if isinstance(node, kinds)]
        exec(compile(ast.Module(imports, []), page.name, "exec"), {})


def test_python_for_views_runs():
    names = {"views": mean_landmarks("bfm72")[None, :, :2]}
    blocks = python_of(FOLDER / "docs" / "photos.md")
    exec(next(block for block in blocks if "(views" in block), names)
    assert names["shapes"].shape == (1, 72, 3)


@pytest.mark.slow
def test_the_method_in_the_readme_runs_and_finds_the_shape_of_a_face(head):
    faces = head.at_landmarks("ibug51")
    rng = np.random.default_rng(0)
    shapes = faces.shape(rng.standard_normal((300, faces.n_identity)))
    views, shapes = sample_views(shapes, 1, yaw=40, pitch=20, roll=0, rng=rng)
    names = {"views": views, "shapes": shapes, "view": views[0]}
    exec("import keras, numpy as np; from scipy.spatial.distance import pdist, squareform", names)
    exec("keras.utils.set_random_seed(0)", names)
    exec("from deepmds_keras import *", names)
    exec(next(block for block in python_of(FOLDER / "README.md") if "autoencoder" in block), names)
    found, mean = pdist(names["shape"]), pdist(normalise(shapes).mean(0))
    assert np.corrcoef(found, mean)[0, 1] > 0.6  # about 0 if the order of the pairs is wrong


def test_every_table_and_figure_of_the_paper_is_in_the_index(paper):
    labels = re.findall(r"\\label{(?:tab|fig):(.*?)}", paper)
    index = text_of("docs/paper.md")
    assert labels and not [label for label in labels if f"`{label}`" not in index]


# Numbers of the code in docs/method.md


def test_the_table_of_networks_is_that_of_the_code():
    networks = {
        "autoencoder, 72 landmarks": build_autoencoder(72),
        "autoencoder, 51 landmarks": build_autoencoder(51),
        "dissimilarity net, paper": build_dissimilarity_net("paper"),
        "dissimilarity net, released": build_dissimilarity_net("released"),
    }
    method = text_of("docs/method.md")
    for name, network in networks.items():
        dense = [layer.units for layer in network.layers if hasattr(layer, "units")]
        widths = " → ".join(map(str, [network.input_shape[1], *dense]))
        trainable, total = count_trainable(network), network.count_params()
        assert f"| {name} | {widths} | {trainable:,} | {total:,} |" in method


def test_numbers_of_the_method_are_those_of_the_code():
    encoder = count_trainable(build_autoencoder(72))
    released, paper = (build_dissimilarity_net(variant) for variant in ("released", "paper"))
    sums = [encoder + count_trainable(net) for net in (released, paper)]
    recipe = Recipe(FULL.autoencoder_epochs)
    steps = FULL.dissimilarity_epochs * FULL.dissimilarity_steps
    method = text_of("docs/method.md") + text_of("docs/deviations.md")
    for text in (
        f"{build_zhao_net(72).count_params():,} parameters",
        f"{count_trainable(build_mobileface_net(199)):,} parameters",
        f"{encoder:,} trainable ones of the autoencoder and all {released.count_params():,} of the",
        "{:,} are trainable, and {:,} with the paper's".format(*sums),
        f"{recipe.epochs} epochs over the {FULL.train_faces:,} faces",
        f"(batch size {recipe.batch_size})",
        f"{steps:,} steps of one face's pairs",
        f"over {FULL.n_subsets} subsets of {FULL.subset_size} faces",
        f"one prediction of {FULL.timed_faces} test faces on one core",
    ):
        assert text in method, text


@pytest.mark.skipif(not MEDIAPIPE, reason="MediaPipe is absent")
def test_the_pitch_from_a_photo_and_from_a_file_is_that_of_the_questions():
    (face,) = predict_photo(FOLDER / "docs/pictures/astronaut.jpg", detector="mediapipe")
    (given,) = predict_landmarks(face.landmarks)
    pitches = f"pitch {given.pose.pitch:.0f}° from a file and {face.pose.pitch:.0f}° from the photo"
    assert pitches.replace("-", "−") in text_of("docs/questions.md")


def test_the_table_of_recipes_is_that_of_the_code():
    zhao, mobileface, ringnet, lifting = (
        {name: option.default for name, option in inspect.signature(method).parameters.items()}
        for method in (Zhao, MobileFace, RingNet, LandmarkLifter)
    )
    net = Recipe(FULL.autoencoder_epochs)
    passes = f"{FULL.train_faces // net.batch_size:,}"
    faces = f"{mobileface['batch_size']} faces"
    rings = f"{ringnet['rings_per_batch']} rings of {ringnet['ring_size']} images"
    zhao_steps = f"{FULL.zhao_epochs} × {FULL.zhao_steps:,}"
    rows = {
        "autoencoder": (net.learning_rate, net.schedule, f"{net.batch_size} faces",
                        f"{FULL.autoencoder_epochs} × {passes}"),
        "dissimilarity net": (net.learning_rate, net.schedule, "pairs of 1 face",
                              f"{FULL.dissimilarity_epochs} × {FULL.dissimilarity_steps:,}"),
        "Zhao et al.": (zhao["learning_rate"], "constant", f"{zhao['batch_size']} faces",
                        zhao_steps),
        "MobileFace": (MOBILEFACE_RATES["cosine"], "cosine", faces,
                       f"{FULL.mobileface_epochs} × {FULL.mobileface_steps}"),
        "MobileFace, `MOBILEFACE=paper`": (
            MOBILEFACE_RATES["constant"], "constant", faces,
            f"{FULL.mobileface_paper_epochs} × {FULL.mobileface_steps}"),
        "RingNet": (ringnet["learning_rate"], "warm-up and cosine", rings,
                    f"{FULL.ringnet_epochs} × {FULL.ringnet_steps}"),
        "LandmarkLifter, in the tables": (lifting["learning_rate"], "cosine",
                                   f"{lifting['batch_size']} faces", f"{FULL.lifting_steps:,}"),
    }  # fmt: skip
    method = text_of("docs/method.md")
    for network, (rate, schedule, batch, steps) in rows.items():
        assert f"| {network} | Adam | {rate:g}, {schedule} | {batch} | {steps} |" in method, network
    assert zhao["optimizer"] == "adam"


# docs/data.md and docs/face-models.md


def test_every_file_name_that_a_loader_looks_for_is_documented():
    data = text_of("docs/data.md") + text_of("docs/face-models.md")
    candidates = [*flame.EMBEDDINGS, *(name for model in MODELS.values() for name in model.files)]
    for files in (AUTHORS_FILES, ZHAO_FILES, MOBILEFACE_FILES):
        candidates += [name for names in files.values() for name in names]
    for candidate in candidates:
        *folders, name = candidate.split("/")
        assert f"`{name}`" in data, name
        assert all(f"{folder}/" in data for folder in folders), candidate
    assert f"{basel.N_VERTICES_2009:,} vertices" in data


def test_sizes_and_hashes_of_files():
    files = [SHARED / "tf_flame" / "flame_static_embedding.pkl"]
    with contextlib.suppress(InputError):
        files.append(find_shape_predictor())
    files = [path for path in files if path.exists()]
    if not files:
        pytest.skip("neither FLAME's public landmark embedding nor dlib's model is at hand")
    for path in files:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        row = f"`{path.name}`, {path.stat().st_size:,} bytes, sha256 `{digest}`"
        assert row in text_of("docs/data.md") + text_of("docs/face-models.md")
