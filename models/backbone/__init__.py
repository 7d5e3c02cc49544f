"""One backbone: a robot of one (``assembly``), its boundary problem (``problem``), and what that is made of.

Its inputs are ``inputs``, the terms that a scene needs ``terms``, what its unknowns mean ``unknowns``, how long, stiff and loaded
its rods are ``sizes``. The equations are in ``kernels``, launches of them and their arrays in ``passes``, what is known of a
solution between base and tip in ``nodes``; what rods carry is in ``members``. ``stability``, ``derivatives``, ``segments`` and
``influence`` are what is asked of a backbone beside its equilibrium, and so are ``shapes``, ``starts`` and ``parts``.
"""
