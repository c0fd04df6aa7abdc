#!/bin/sh
# Checks that links between documents and names of decisions and headers in sources lead to files, and that
# each decision has its own number.
cd "$(dirname "$0")/../.." || exit 1
bad=0
complain() { echo "documents: $*"; bad=1; }
for page in *.md docs/*.md docs/decisions/*.md formats/*.md tests/*/*.md \
    libbake/*/*.md formats/*/*.md; do
    for link in $(grep -oE '\]\([^)#]+' "$page" | sed 's/^](//' | grep -v '^http'); do
        [ -e "$(dirname "$page")/$link" ] || complain "$page: $link does not exist"
    done
done
for page in $(grep -rohE 'docs/decisions/[0-9]{4}[a-z0-9-]*\.md' base formats libvoxel libbake \
    tools tests man *.md | sort -u); do
    [ -e "$page" ] || complain "$page does not exist"
done
# "decisions/0001 and 0002", as sources and pages say it.
for number in $(grep -rohE 'decisions?[/ ][0-9]{4}((,| and) [0-9]{4})*' base formats libvoxel libbake tools \
    tests man docs *.md | grep -oE '[0-9]{4}' | sort -u); do
    ls docs/decisions/"$number"-*.md >/dev/null 2>&1 || complain "there is no decision $number"
done
# Headers that comments name.
for header in $(grep -rhE --include='*.[ch]' '^ *(/\*| \*) ' base formats libvoxel libbake tools tests |
    grep -oE '(see|See|of) [a-z0-9_/]*[a-z0-9_]\.h\b' | sed 's/.*[ /]//' | sort -u); do
    [ -n "$(git ls-files "$header" "*/$header")" ] || complain "a comment names $header, which does not exist"
done
for number in $(ls docs/decisions | cut -c1-4 | uniq -d); do
    complain "several decisions have the number $number"
done
[ $bad -eq 0 ] && echo "documents: ok"
exit $bad
