"""The commands ggavatar-eval, ggavatar-render and ggavatar-view."""
