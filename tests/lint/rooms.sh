#!/bin/sh
# Checks who includes whom between rooms: tests/lint/rooms.txt says what is allowed.
cd "$(dirname "$0")/../.." || exit 1
grep -rnE '^#[[:space:]]*include[[:space:]]+"' base formats libvoxel libbake tools \
    --include='*.[ch]' --include='*.cc' --include='*.cl' | sed 's/:[0-9]*:/:/' |
    awk -f tests/lint/rooms.awk tests/lint/rooms.txt - && echo "rooms: ok"
