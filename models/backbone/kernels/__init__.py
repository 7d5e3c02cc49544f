"""What integrates a backbone, in lanes (``integrate``, and ``docs/kernels.md``).

``lanes`` and ``vectors`` are the numbers; ``layout`` says how they stand. Along a stretch, in all lanes at once: ``strains``,
``loads``, ``rates``, ``steps``. At the ends and at nodes, one lane at a time: ``grid``, ``base``, ``tip``, ``nodes``, by
``records`` and ``scalars``.
"""
