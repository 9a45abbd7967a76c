"""The commands ggavatar-train, ggavatar-sweep and ggavatar-export, and what all commands share."""
