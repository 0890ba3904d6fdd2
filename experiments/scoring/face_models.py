"""Names of the face models in texts."""

TITLES = {
    "openhead": "the open head",
    "ict": "ICT faces",
    "bfm2009": "Basel Face Model 2009",
    "bfm2017": "Basel Face Model 2017",
    "bfm2019": "Basel Face Model 2019",
    "flame": "FLAME",
    "surrey": "Surrey faces",
}
