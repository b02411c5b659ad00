"""The controller's five tasks: each says which acceleration it wants."""
