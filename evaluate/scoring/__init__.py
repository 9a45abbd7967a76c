"""From runs and folders of images to scores."""
