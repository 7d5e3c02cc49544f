"""Where to begin when nothing is known: assemblies put together, many starts."""
