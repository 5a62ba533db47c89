"""Other packages on the same flights, by the same prediction protocol; run by `bench_peers.py`."""
