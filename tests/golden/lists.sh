# For compare.sh and check.sh: what golden.sh has listed.

# differing OLD NEW: the files on which two lists of hashes do not agree, each behind "changed", "gone" or "new".
differing() {
    awk 'FNR == 1 { file++ }
        { hash = substr($0, 1, 64); name = substr($0, 67) }
        file == 1 { old[name] = hash; next }
        !(name in old) { print "new", name; next }
        { if (old[name] != hash) print "changed", name; delete old[name] }
        END { for (name in old) print "gone", name }' <(cat "$1"; echo) <(cat "$2"; echo) | awk 'NF == 2' | sort -k 2
}
