"""Avatar methods; every file here is one method and registers itself by its name (docs/adding-a-method.md)."""
