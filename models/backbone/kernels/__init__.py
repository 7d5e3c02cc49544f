"""What integrates a backbone, in lanes (``integration/integrate``, and ``docs/kernels.md``).

``numbers`` has lanes and vectors, ``layout`` how they stand. ``equations`` says what holds along a stretch, in all lanes at once
(``strains``, ``rates``; loads are in ``loads``, what rods carry in ``members``), and at the ends, one lane at a time
(``conditions``, ``base``, ``tip``). ``integration`` takes the ``steps``, walks from stretch to stretch (``walk``, ``grid``), and
writes what there is at nodes (``nodes``); ``instance`` has what each lane's rods are, ``records`` what it carries.
"""
