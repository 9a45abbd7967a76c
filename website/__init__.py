"""The documentation site: what mkdocs needs besides docs/ (mkdocs.yml; `make docs`)."""
