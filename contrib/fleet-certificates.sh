#!/usr/bin/env bash
# Certificates for the stations of a fleet: an authority of its own, and one certificate for each station, by which stations know each other.
#     contrib/fleet-certificates.sh FOLDER HOST..
# HOST is the name or address by which others connect to a station. Keep authority.key to yourself; a station needs authority.pem, HOST.pem
# and HOST.key (docs/fleet.md). Needs openssl.
set -euo pipefail

folder="${1:?a folder}"
shift
mkdir -p "$folder"
cd "$folder"
umask 077
if [[ ! -e authority.pem ]]; then
    openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 36500 \
        -subj "/CN=posebridge fleet" -keyout authority.key -out authority.pem
fi
for host in "$@"; do
    kind=DNS
    [[ "$host" =~ ^[0-9.]+$ || "$host" == *:* ]] && kind=IP
    openssl req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj "/CN=$host" -keyout "$host.key" -out "$host.csr"
    openssl x509 -req -in "$host.csr" -CA authority.pem -CAkey authority.key -CAcreateserial -days 36500 \
        -extfile <(printf 'subjectAltName=%s:%s\nextendedKeyUsage=serverAuth,clientAuth\n' "$kind" "$host") -out "$host.pem"
    rm "$host.csr"
done
