"""Throughput of gpcjax beside its peers: `make bench`."""
