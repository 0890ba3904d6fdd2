"""Words of the report on experiments, figures and face models; no numbers."""

from __future__ import annotations

# Title and introduction by the folder's name.
EXPERIMENTS = {
    "bfm": (
        "The paper's BFM table",
        "Random faces of the face model, neutral, seen in the views of the paper: {train_faces} to "
        "train on, {test_faces} to test. The 72 landmarks of one view go in, their 3D shape comes "
        "out.",
    ),
    "bfm-evaluator-released": (
        "BFM, scored by the authors' script",
        "The same predictions. The authors' script joins the depth that Zhao's net predicts, "
        "rescaled by itself, to the true x and y; every other method is scored as before.",
    ),
    "flame": (
        "The paper's CASIA-3D table",
        "Photos and scans of expressive faces, 51 landmarks: {frames} frames to train on, {scans} "
        "scans to test, less those in whose photo no face is found or whose registration fails. "
        "For the truth stands what a fit of the face model to the photo finds on "
        "the scan, as in the paper.",
    ),
    "flame-true-landmarks": (
        "CASIA-3D, against the true landmarks",
        "The same predictions. The true landmarks are known because the scans are made from a "
        "face model.",
    ),
    "celeba": (
        "The paper's CelebA table",
        "{photos} photos of faces, less those in which no face is found; 72 landmarks. For the "
        "truth stands a fit of the face model to landmarks and edges of the photo, as in the "
        "paper.",
    ),
    "celeba-true-landmarks": (
        "CelebA, against the true landmarks",
        "The same predictions. The true landmarks are known because the photos are renders of a "
        "face model.",
    ),
    "celeba-flame": (
        "The paper's CelebA faces with FLAME's landmarks",
        "Photos with 51 landmarks and no truth: what each method makes of them.",
    ),
    "celeba-flame-stand-in": (
        "FLAME's landmarks in rendered photos",
        "In place of CelebA's, which may not be shown: photos drawn of the face model, turned by "
        "up to 45°, with the landmarks that dlib finds; what each method makes of them.",
    ),
    "audit": (
        "Which claims of the paper hold",
        "Each claim of the paper as a check that is run here.",
    ),
    "ablation": (
        "What the parts are good for",
        "The dissimilarity net trained from several seeds in each of several ways, on the frontal "
        "views of one autoencoder, and both networks on fewer faces; scored on "
        "{subset_size} test faces.",
    ),
    "parameters": (
        "Parameters and time",
        "The paper's table of trainable parameters and time complexity.",
    ),
    "seeds": (
        "How much is luck",
        "Deep-MDS in each of its forms, and the mean shape, trained from several seeds.",
    ),
    "rounding": (
        "The same seed, rounded otherwise",
        "The paper's recipe from one seed, twice as it is (instructions up to AVX2, two threads), "
        "with one thread, and compiled for instructions of other processors. Only the "
        "dissimilarity net's training is compiled, not the autoencoder's.",
    ),
    "stream": (
        "Many faces: the tails of the errors",
        "{streamed_faces} random faces of the face model in the views of the paper, made and "
        "scored file by file.",
    ),
    "pretrained": (
        "The weights that ship with the package",
        "Trained for photos, on views that are centred and err as a landmark detector does; tested "
        "on other faces of the same model, on such views and on exact ones.",
    ),
    "lifting/hard": (
        "Hard views, against the limit",
        "Faces turned far, seen from near, with errors and without some of their landmarks: what "
        "each method makes of them, and what no method can know. {test_faces} test faces; the face "
        "model is fitted to {fitted_faces}.",
    ),
    "lifting/anatomy": (
        "Anatomy of Deep-MDS",
        "Its parts replaced one at a time by better ones, down to what no method can know; on the "
        "first {audited_faces} test faces. The two dissimilarity nets that are told more are "
        "trained here, on shuffled pairs.",
    ),
    "lifting/transfer": (
        "Transfer between face models",
        "Trained on {train_faces} faces of this model and tested on {test_faces} of either open "
        "one: with expressions, posed as in photos, with errors of the landmarks.",
    ),
}
TABLES = {
    "seeds": "Over the seeds: median, mean, s.d. of a sample, and range.",
    "stream": "Over all faces: mean, s.d., standard error of the mean, and how the faces spread.",
    "pretrained": "MSE in squares of the min-max unit of a face.",
}
# By the stage that makes what stands in.
DATA_SETS = {
    "frames": "CoMA: its registered meshes need registration",
    "scans": "CASIA-3D FaceV1: its photos and scans need registration",
    "photos": "CelebA: its photos must be downloaded by hand",
}
FIGURES = {
    "summary": "Every method: ours filled, the paper's hollow.",
    "qualitative": "Typical faces: input view, frontal view, truth and every method.",
    "casia": "Photos of typical faces: frontal view, truth and every method.",
    "celeba": "Photos of typical faces: frontal view, truth and every method.",
    "celeba_flame": "What every method makes of the photos.",
    "fits": "The face model fitted to photos, and how far it is from the true landmarks.",
    "renders": "What MobileFace sees; the lower half with the landmarks.",
    "photos": "What MobileFace sees; the lower half with the landmarks.",
    "error_per_landmark": "Where on the face the error is.",
    "error_per_pose": "Error by projection and pose.",
    "error_per_expression": "Error by expression.",
    "scans": "Photos, scans, the landmarks found on them, and how far they are from the true ones.",
    "anatomy": "Error step by step; what lies in the shaded part no method can know.",
    "transfer": "Error by noise, on faces of either model.",
    "errors_by_yaw": "Error by yaw; below the dashed limit no method can be.",
    "errors_by_condition": "Error by noise, and by missing landmarks; dashed the limit.",
    "reliability": "Share of the true coordinates within intervals of their predicted s.d.",
    "errors": "Share of the faces whose error is smaller.",
    "learning_curves": "Learning curves.",
    "poses": "Error by pose and field of view; the shaded part was trained on.",
    "perturbations": "Error by noise on the landmarks and by landmarks that are missing.",
    "bias": "How much of a face's difference from the mean shape a method finds: by how much it "
    "shrinks it, and how well it correlates.",
    "spectra": "Eigenvalues of the doubly centred squared dissimilarities.",
    "timings": "Time by number of landmarks.",
    "mini_batches": "Losses of the dissimilarity net, by what a mini-batch holds.",
    "training_faces": "Error by number of training faces.",
    "seed_spread": "Error of every training run.",
    "batchnorm_lag": "The autoencoder's error by moving statistics, by those of the mini-batch, "
    "and by statistics estimated anew.",
}
