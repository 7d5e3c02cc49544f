"""What integrates a backbone, in lanes (``integration/integrate``, and ``docs/kernels.md``).

``numbers`` has lanes and vectors, ``layout`` how they stand. ``equations`` says what holds along a stretch, in all lanes at once
(``strains``, ``rates``; loads are in ``loads``), and at the ends, one lane at a time (``conditions``, ``base``, ``tip``).
``integration`` takes the steps, and ends them where stretches end (``grid``) and at nodes (``nodes``); ``records`` keeps what
comes of it.
"""
