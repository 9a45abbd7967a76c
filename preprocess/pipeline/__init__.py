"""The stages of ggavatar-prep, in order, each skipped when its inputs are unchanged."""
