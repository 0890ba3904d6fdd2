# %% [markdown]
# # The paper's method, step by step
#
# Deep-MDS (Kamyab and Azimifar 2022, [arXiv:2210.15200](https://arxiv.org/abs/2210.15200)) turns
# the landmarks of one view into a 3D shape. An autoencoder predicts the frontal view, a second
# network estimates the 3D distance of every pair of landmarks, and non-metric multidimensional
# scaling (MDS) finds points with these distances. Here it is trained on the open head, which comes
# with this repository, with fewer faces and steps than `make reproduce-bfm`; this takes a few
# minutes on two cores. `make setup` installs what it needs.

# %%
import sys

sys.path += [".", ".."]  # the repository, seen from its root or from docs/

import keras
import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.distance import pdist, squareform

from data_gen.datasets.dataset import make_dataset
from data_gen.models.registry import load_model
from deepmds_keras import (
    align,
    build_autoencoder,
    build_dissimilarity_net,
    embed,
    load_scheme,
    normalise,
    pair_features,
)
from deepmds_keras.metrics import mse

# %% [markdown]
# ## Faces and views
#
# Each face has random proportions and 72 landmarks, and is seen once: turned to a side or not,
# orthographic or in perspective. Shapes and views are scaled to [0, 1] over all their coordinates.

# %%
faces = make_dataset(load_model("openhead"), 4_050, np.random.default_rng(0))
shapes, views = normalise(faces.landmarks), normalise(faces.views)
train, test = slice(4_000), slice(4_000, None)
print("shapes", shapes.shape, "views", views.shape)

# %% [markdown]
# ## Autoencoder: any view to the frontal view
#
# The target is x and y of the shape.

# %%
autoencoder = build_autoencoder(72, seed=0)
autoencoder.compile(keras.optimizers.Adam(1e-3), "mse", steps_per_execution=50)
flat = views.reshape(len(views), -1)
frontal = shapes[..., :2].reshape(len(shapes), -1)
keras.utils.set_random_seed(0)  # of the order of the faces
losses = autoencoder.fit(flat[train], frontal[train], batch_size=16, epochs=20, verbose=0)
print("losses of the first and last epoch:", *np.round(losses.history["loss"], 5)[[0, -1]])

# %% [markdown]
# ## Dissimilarity net: a pair of landmarks to its distance in 3D
#
# The input is six features of each pair in the autoencoder's view. The 2,556 pairs of one face are
# a mini-batch; every other face is used, for 8,000 mini-batches.

# %%
seen = normalise(autoencoder.predict(flat, batch_size=1024, verbose=0).reshape(views.shape))
features = pair_features(seen)
distances = np.stack([pdist(shape) for shape in shapes])
n_pairs = distances.shape[1]

net = build_dissimilarity_net(seed=0)
net.compile(keras.optimizers.Adam(1e-3), "mse", steps_per_execution=50, jit_compile=True)
some = slice(0, 4_000, 2)
pairs = features[some].reshape(-1, 6), distances[some].reshape(-1, 1)
losses = net.fit(*pairs, batch_size=n_pairs, epochs=4, shuffle=False, verbose=0)
print("losses of the first and last epoch:", *np.round(losses.history["loss"], 5)[[0, -1]])

# %% [markdown]
# ## MDS: distances to a shape
#
# `embed` is scikit-learn's non-metric `MDS`. Distances determine neither position, rotation nor
# mirror image, so each shape is aligned to the true one before it is scored, as in the paper. From
# true distances MDS returns the true shape: the remaining error comes from the networks.

# %%
estimated = net.predict(features[test].reshape(-1, 6), batch_size=1 << 15, verbose=0)
estimated = np.abs(estimated).reshape(-1, n_pairs)
true = shapes[test]


def embedded(distances):
    return align(embed(np.stack([squareform(d) for d in distances])), true)


mean_shape = align(np.broadcast_to(shapes[train].mean(0), true.shape), true)
results = {
    "Deep-MDS": embedded(estimated),
    "MDS of true distances": embedded(distances[test]),
    "mean shape of the training faces": mean_shape,
}
errors = {name: mse(result, true).mean() for name, result in results.items()}
for name, error in errors.items():
    print(f"{name:<33}{error / 1e-4:.4f} × 10⁻⁴")

# %% [markdown]
# The mean shape, which ignores the view, has a lower error than the method. The same holds with all
# faces and steps (`make reproduce-bfm`).
#
# ## One face

# %%
scheme, k = load_scheme("bfm72"), 0
shape = results["Deep-MDS"][k]
panels = {
    "view": ([views[test][k]], 0, 1),
    "frontal view": ([seen[test][k]], 0, 1),
    "shape (grey: true)": ([true[k], shape], 0, 1),
    "from the side": ([true[k], shape], 2, 1),
}
figure, axes = plt.subplots(1, 4, figsize=(9, 2.4))
for panel, (title, (points_of, x, y)) in zip(axes, panels.items(), strict=True):
    colours = ["tab:blue"] if len(points_of) == 1 else ["0.6", "tab:blue"]
    for points, colour in zip(points_of, colours, strict=True):
        for line in scheme.polylines:
            panel.plot(points[line, x], points[line, y], color=colour, linewidth=1)
    panel.set_title(title)
    panel.set_aspect("equal")
    panel.axis("off")
plt.show()
