"""Fuzzer: random problems through the public interface of optdock, checked by an oracle with separate geometry code.

    python -m experiments.fuzz --seconds 600 --seed 1 --jobs 2
    python -m experiments.fuzz --kinds paths,plans --count 1000
    python -m experiments.fuzz --plant tolerance_x5 --kinds paths      # must find the planted mistake
    python -m experiments.fuzz --replay results/fuzz/paths-1-42.json

A case is plain data, determined by (kind, seed, number). `generators` draw cases, `doors` convert them to values of the
library, `kinds` call the library and compare the result with `oracle`, which reads the case directly and shares no code
with optdock. Failing cases are shrunk by `minimise` and saved; `planted` breaks the certificate on purpose, to test the
fuzzer.
"""
