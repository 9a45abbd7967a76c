"""The commands `ggavatar-prep`, `ggavatar-doctor` and `ggavatar-demo`."""
