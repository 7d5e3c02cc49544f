"""What holds a rod at both ends, in kernels. Numbers in parentheses are those of ``docs/held.md``."""
