"""All mutants of a file in one text.

Where mutant 7 has a * b and the source a + b stands

    (mutant_is(7) ? (a * b) : (a + b))

so that one build serves every mutant and the program is told on its start which of them it is.
"""

from __future__ import annotations

from collections.abc import Mapping

from mutation.operators import Mutant

MUTANTS_MAX = 20000

HEADER = """\
extern int mutant_chosen;
extern unsigned char mutant_reached[];

__attribute__((no_sanitize("address", "undefined"), always_inline)) static inline int mutant_is(int number)
{
    mutant_reached[number] = 1;
    return number == mutant_chosen;
}
"""

# The processor time is this program's own, so that a busy machine kills no mutant.
RUNTIME = """\
#include <stdio.h>
#include <stdlib.h>
#include <sys/time.h>

int mutant_chosen = -1;
unsigned char mutant_reached[MUTANTS_MAX];

__attribute__((constructor)) static void choose(void)
{
    const char *number = getenv("MUTANT"), *limit_ms = getenv("MUTANT_LIMIT_MS");
    if (number != NULL) {
        mutant_chosen = atoi(number);
    }
    if (limit_ms != NULL) {
        const struct itimerval timer = {.it_value = {atoi(limit_ms) / 1000, atoi(limit_ms) % 1000 * 1000}};
        setitimer(ITIMER_VIRTUAL, &timer, NULL);
    }
}

__attribute__((destructor)) static void tell(void)
{
    const char *path = getenv("MUTANT_REACHED");
    FILE *file = path != NULL ? fopen(path, "wb") : NULL;
    if (file != NULL) {
        fwrite(mutant_reached, 1, sizeof mutant_reached, file);
        fclose(file);
    }
}

/* Unity's way out of a failed assertion: one is enough. */
void mutant_stop(void);
void mutant_stop(void)
{
    exit(1);
}
""".replace("MUTANTS_MAX", str(MUTANTS_MAX))


def mutated(text: bytes, mutant: Mutant) -> bytes:
    """Return the text of a file with one mutant in it."""
    return text[: mutant.start] + mutant.text.encode() + text[mutant.end :]


class Schemata:
    """The mutants of one file, by number, nested as they are in the text."""

    def __init__(self, text: bytes, mutants: Mapping[int, Mutant]) -> None:
        self._text = text
        self._sites: dict[tuple[int, int], dict[int, Mutant]] = {}
        for number, mutant in mutants.items():
            if not mutant.is_constant:
                self._sites.setdefault((mutant.start, -mutant.end), {})[number] = mutant
        self._order = sorted(self._sites)

    def render(self) -> bytes:
        """Return the text with every mutant in it."""
        return self._between(0, len(self._text), self._order)

    def _between(self, start: int, end: int, sites: list[tuple[int, int]]) -> bytes:
        parts, at, i = [], start, 0
        while i < len(sites):
            first, last = sites[i][0], -sites[i][1]
            inner = [site for site in sites[i + 1 :] if site[0] < last]
            parts += [self._text[at:first], self._site(sites[i], inner)]
            at, i = last, i + 1 + len(inner)
        return b"".join([*parts, self._text[at:end]])

    def _site(self, site: tuple[int, int], inner: list[tuple[int, int]]) -> bytes:
        here = self._sites[site]
        rest = self._between(site[0], -site[1], inner)
        cast = b"(void)" if any(m.is_statement for m in here.values()) else b""
        choices = b"".join(b"mutant_is(%d) ? %s(%s) : " % (n, cast, m.text.encode()) for n, m in here.items())
        return b"(" + choices + cast + b"(" + rest + b"))"
