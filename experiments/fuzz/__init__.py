"""A fuzzer: random problems through the public doors of optdock, judged by an oracle with its own geometry.

    python -m experiments.fuzz --seconds 600 --seed 1 --jobs 2
    python -m experiments.fuzz --kinds paths,plans --count 1000
    python -m experiments.fuzz --plant tolerance_x5 --kinds paths      # must find the planted mistake
    python -m experiments.fuzz --replay results/fuzz/paths-1-42.json

A case is plain data, drawn from (kind, seed, number) and from nothing else. `generators` draw cases, `doors` turn them
into values of the library, `kinds` ask the library and compare with `oracle`, which reads the case itself and shares no
code with optdock. What fails is shrunk by `minimise` and saved; `planted` breaks the certificate on purpose, to see
that the fuzzer notices.
"""
