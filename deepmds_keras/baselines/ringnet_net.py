"""RingNet's network: ResNet-50, and a regressor that corrects its own estimate a few times."""

from __future__ import annotations

import keras
from keras import layers, ops

from deepmds_keras.errors import InputError
from deepmds_keras.networks import draw_kernels

N_CAMERA, N_ROTATION = 3, 3
MIN_IMAGE_SIZE = 32  # ResNet-50 halves an image five times
_ITERATIONS = 3
_HIDDEN = 512
_DROPOUT = 0.2
_INITIAL_STEP = 0.01  # so that training starts about the mean face, seen from the front
_MOMENTUM = 0.9


def build_ringnet(
    n_identity: int,
    n_expression: int,
    image_size: int = 96,
    seed: int = 0,
    *,
    iterations: int = _ITERATIONS,
) -> keras.Model:
    """ResNet-50 on an image, and the camera, pose and coefficients of the face by iteration.

    After Sanyal et al. 2019, arXiv:1905.06817. The 2,048 features of ResNet-50 and the parameters
    as estimated so far go through two layers of 512 ReLU units with dropout and a linear one. Its
    output is added to the estimate. The layers are the same in all iterations, of which there are
    three, as in Kanazawa et al. 2018 (HMR, arXiv:1712.06584), whose regressor it is.

    Two things are ours. The moving averages of the batch normalisation forget ten times as fast as
    Keras's by default. In a training of a few thousand steps they would lag behind the weights. And
    dropout takes a fifth of the units; the sources at hand do not say how many theirs does.

    Args:
        n_identity: Identity coefficients.
        n_expression: Expression coefficients.
        image_size: Width and height of the images, at least 32 pixels.
        seed: Of the initial weights.
        iterations: Corrections of the estimate.

    Returns:
        Model from `(n, image_size, image_size, 3)` images in [-1, 1] to the parameters,
        `(n, 6 + n_identity + n_expression)`: log scale, x, y, axis-angle, identity, expression. All
        of them zero are the mean face, seen from the front in the middle of the image.

    Raises:
        InputError: Images of less than 32 pixels.
    """
    if image_size < MIN_IMAGE_SIZE:
        raise InputError(f"image_size must be at least {MIN_IMAGE_SIZE}. Received {image_size}.")
    body = _resnet50(image_size)
    for layer in body.layers:
        if isinstance(layer, layers.BatchNormalization):
            layer.momentum = _MOMENTUM
    n_parameters = N_CAMERA + N_ROTATION + n_identity + n_expression
    hidden = []
    for number in (1, 2):
        hidden.append(layers.Dense(_HIDDEN, activation="relu", name=f"regressor_{number}"))
        hidden.append(layers.Dropout(_DROPOUT, seed=number, name=f"dropout_{number}"))
    step = layers.Dense(n_parameters, name="correction")
    join = layers.Concatenate(name="features_and_estimate")
    features = body.output
    estimate = ops.zeros_like(features[:, :1]) * ops.zeros((1, n_parameters))
    for _ in range(iterations):
        x = join([features, estimate])
        for layer in hidden:
            x = layer(x)
        estimate = estimate + step(x)
    net = keras.Model(body.input, estimate, name=f"ringnet_{n_identity}_{n_expression}")
    draw_kernels(net, seed)
    step.kernel.assign(_INITIAL_STEP * step.kernel)
    return net


def _resnet50(image_size: int) -> keras.Model:
    """From images to the means of its last maps, 2,048 numbers."""
    return keras.applications.ResNet50(
        input_shape=(image_size, image_size, 3), include_top=False, weights=None, pooling="avg"
    )


def seed_dropout(net: keras.Model, seed: int, epoch: int) -> None:
    """Make what dropout takes in an epoch depend on the epoch alone, as in an unbroken training."""
    for number, layer in enumerate(
        layer for layer in net.layers if isinstance(layer, layers.Dropout)
    ):
        layer.seed_generator.state.assign([1000 * seed + number, epoch])
