"""Studies beside the paper's tables: ablation, seeds, a million faces."""
