"""Files of other programs: splats in and out, GaussianAvatars' bound layout, and the command ggavatar-export."""
