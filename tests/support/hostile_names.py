"""Names that attack the outputs they are shown in, names of people that must survive, and a strategy for both."""

from __future__ import annotations

from hypothesis import settings, strategies

HOSTILE = (
    "\x1b]0;owned\x07\x1b[31mred\x1b[2J",
    "Anna\n::error title=forged::owned\r\n::set-output name=a::b",
    "::error::owned",
    "##[error]owned ##vso[task.complete result=Failed;]",
    "a\u202egnp.exe\u202c\u2066b\u2069",
    "\ufffe\uffff\ufdd0\U0001ffff",
    "\x00\x08\x7f\x85\x9b31m",
    b"caf\xe9".decode(errors="surrogateescape"),
    "\ud800 \udfff",
    '=HYPERLINK("https://x.example","click")',
    "@SUM(1+1)*cmd|' /C calc'!A0",
    "+cmd|' /C calc'!A0",
    "-2+3+cmd|' /C calc'!A0",
    "\t=1+1",
    "a;=1+1;-1",
    "＝1+1",
    '"=1+1',
    "<script>alert(1)</script><img src=x onerror=alert(1)>",
    "\" onmouseover='alert(1)' x=\"",
    "</script><!--",
    "{{ 7 * 7 }}{% raw %}",
    "![x](https://x.example/a.png) [y](javascript:alert(1)) <https://x.example>",
    "https://x.example www.x.example mailto:a@x.example",
    "a | b\n| --- | --- |\n# c",
    "- [ ] 1. > ``` ~~~ === *a* _b_ ~~c~~",
    "# heading",
    "> quote",
    "12) list",
    "- - -",
    "$\\write18{id}$ \\input{/etc/passwd} ^^5cinput %",
    "$x^$ $$ \\$",
    "}\\end{tabular}\\input{x}",
    "--``?`''!`,,<<>>",
    "&lt;b&gt; &#60; &amp",
    "]]>",
    "../../etc/passwd",
    "con.txt",
    ".",
    "_hidden",
    "\u200b\u200d\u3164",
    "a" * 3_000,
    "e" + "\u0301" * 500,
    "   ",
    "",
)
"""Each is aimed at one output or more."""

NATURAL = (
    "Anna",
    "my_subject_01",
    "w/o LBS (ours)",
    "Zoë Müller-Łukasz",
    "Nguyễn Văn An",
    "张三",
    "さくら",
    "김민수",
    "Ольга",
    "שרה",
    "محمد علی\u200cرضا",
    "👩\u200d🦰 take 2",
    "lr=1e-3, λ2",
    "O'Neil & Sons",
)
"""Names that come through cleaning as they are."""

TEXTS = strategies.one_of(
    strategies.sampled_from((*HOSTILE, *NATURAL)),
    strategies.text(strategies.characters(exclude_categories=()), max_size=40),
    strategies.text("=+-@;,\"'\t\n\r |*_`~#>[]()!<>&$\\{}^%:/1.a\x1b\u202e\ufffe\udc80", max_size=30),
)
"""Any text, surrogates included, with those above and mixtures of special characters often among them."""

patient = settings(deadline=None, max_examples=200)
"""For properties of texts: the first example of a test may have to import what it draws with."""
