"""MediaPipe's models: loaded lean and silently; what is missing or no model is named."""

import subprocess
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from places import MEDIAPIPE, ROOT

from deepmds_keras.detection.mediapipe_landmarks import MediaPipeLandmarks
from deepmds_keras.detection.mediapipe_models import FaceMesh, has_face_mesh
from deepmds_keras.errors import InputError

IMAGE = np.zeros((40, 80, 3), np.uint8)


@pytest.fixture
def later(monkeypatch):
    """Puts a later MediaPipe in place: `later(n_points, error)`, which keeps what it was given."""

    def later(n_points=478, error=None):
        point = SimpleNamespace(x=0.5, y=0.25, z=-0.125)

        def create(options):
            package.given = options
            if error is not None:
                raise error
            faces = [[SimpleNamespace(**vars(point) | {"x": i / 1000}) for i in range(n_points)]]
            return SimpleNamespace(detect=lambda image: SimpleNamespace(face_landmarks=faces))

        package = ModuleType("mediapipe")
        package.ImageFormat = SimpleNamespace(SRGB=1)
        package.Image = lambda image_format, data: (image_format, data)
        package.tasks = SimpleNamespace(
            BaseOptions=dict,
            vision=SimpleNamespace(
                FaceLandmarkerOptions=dict,
                FaceLandmarker=SimpleNamespace(create_from_options=create),
            ),
        )
        monkeypatch.setitem(sys.modules, "mediapipe", package)
        return package

    return later


@pytest.mark.skipif(not MEDIAPIPE, reason="MediaPipe is not installed")
def test_face_mesh_is_all_that_is_loaded_and_it_is_silent():
    code = """
import sys
import numpy as np
from deepmds_keras.detection.mediapipe_landmarks import shared_detector
print(len(shared_detector().detect_all(np.full((40, 80, 3), 255, np.uint8))))
names = {name for name in sys.modules if name.split(".")[0] == "mediapipe"}
print({name for name in names if not name.startswith("mediapipe.python._framework_bindings")})
print({"tensorflow", "cv2", "matplotlib", "jax"} & {*sys.modules})
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split() == ["0", "set()", "set()"]


def test_without_face_mesh_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mediapipe", None)
    assert not has_face_mesh()
    with pytest.raises(InputError, match=r"pip install 'deepmds-keras\[mediapipe\]'") as refused:
        FaceMesh(1)
    assert "\n" not in str(refused.value) and "3.10 to 3.12" in str(refused.value)


def test_a_landmarker_gives_the_468_points_before_the_irises(tmp_path, later):
    package = later()
    (tmp_path / "own.task").write_bytes(b"a model")
    (face,) = MediaPipeLandmarks(tmp_path / "own.task", max_faces=3).detect_all(IMAGE)
    assert package.given == {"base_options": {"model_asset_buffer": b"a model"}, "num_faces": 3}
    assert face.shape == (468, 3)
    np.testing.assert_allclose(face[:, 0], np.arange(468) / 1000 * 80, rtol=1e-6)
    np.testing.assert_allclose(face[:, 1:], [[0.25 * 40, 0.125 * 80]] * 468)


def test_a_landmarker_that_cannot_be_read_is_named(tmp_path, later):
    path = tmp_path / "own.task"
    with pytest.raises(InputError, match=r"own.task must be a face landmarker.*No such file"):
        MediaPipeLandmarks(path)
    with pytest.raises(InputError, match=r"must be a face landmarker.*directory"):
        MediaPipeLandmarks(tmp_path)
    path.write_bytes(b"no model")
    later(error=RuntimeError("Unable to open\nzip archive."))
    said = r"own.task must be a face landmarker.*RuntimeError: Unable to open zip archive\.$"
    with pytest.raises(InputError, match=said):
        MediaPipeLandmarks(path)
    later(n_points=21)
    with pytest.raises(InputError, match=r"own.task must be .* Received: 21 points a face"):
        MediaPipeLandmarks(path).detect_all(IMAGE)


def test_a_landmarker_needs_a_later_mediapipe(tmp_path, later, monkeypatch):
    path = tmp_path / "own.task"
    path.write_bytes(b"a model")
    later(error=TypeError("create(): incompatible function arguments"))
    with pytest.raises(InputError, match="0.10.30 or later.*TypeError: create"):
        MediaPipeLandmarks(path)
    monkeypatch.setitem(sys.modules, "mediapipe", None)
    with pytest.raises(InputError, match="pip install -U mediapipe"):
        MediaPipeLandmarks(path)
