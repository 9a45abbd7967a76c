"""From trained runs or folders of images to numbers, tables, figures and reports, under a stated protocol."""
