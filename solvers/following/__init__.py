"""What a robot does where its branch of equilibria ends: it buckles or snaps, and goes on (``docs/branches.md``)."""
