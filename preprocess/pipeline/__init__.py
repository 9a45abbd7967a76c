"""The stages of `ggavatar-prep`, each of which is skipped while its inputs are unchanged."""
