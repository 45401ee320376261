#!/bin/sh
# Joins this machine to a Ray cluster for sweeps, in the foreground until Ctrl-C. On the first machine, then on others:
#
#     sweeps/cluster/ray.sh                              it says its address, HOST:6379
#     sweeps/cluster/ray.sh HOST:6379
#     gpcjax sweep ... --engine ray --address auto       on any of them
#
# Each needs the same gpcjax and the same versions (pip install 'gpcjax[cluster]'), and nothing else in common. Ray trusts
# whoever reaches its ports: let no other network reach them. CORES are those to be used (all); ADDRESS is the one of
# this machine that the others reach (Ray's choice); RAY is the command (ray).
export RAY_USAGE_STATS_ENABLED=0
if [ $# -eq 0 ]; then set -- --head --port=6379 --include-dashboard=false; else set -- --address="$1"; fi
exec ${RAY:-ray} start "$@" --disable-usage-stats --block ${CORES:+--num-cpus="$CORES"} ${ADDRESS:+--node-ip-address="$ADDRESS"}
