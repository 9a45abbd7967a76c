"""The commands ggavatar-eval and ggavatar-render."""
