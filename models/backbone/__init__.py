"""One backbone: its boundary problem (``problem``), its segments (``segments``), and launches of what integrates it (``passes``).

The equations are in ``kernels``; what rods carry is in ``members``. ``stability``, ``derivatives`` and ``influence`` are what is
asked of a backbone beside its equilibrium.
"""
