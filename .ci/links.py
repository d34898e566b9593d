"""Checks relative links and anchors of all Markdown files of the repository, and that source files they name exist.

Prints what is broken; exit code 1 if anything is.
"""
import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

root = Path(__file__).resolve().parent.parent


def prose(text):
    """The text without fenced blocks and code, where brackets are no links; lines keep their numbers."""
    text = re.sub(r"^```.*?^```", lambda m: "\n" * m[0].count("\n"), text, flags=re.M | re.S)
    return re.sub(r"`[^`\n]*`", lambda m: "_" * len(m[0]), text)


@cache
def anchors(path):
    """The anchors of a page's headings, as GitHub and mdBook make them."""
    found = set()
    text = re.sub(r"^```.*?^```", "", path.read_text(), flags=re.M | re.S)
    # mdBook puts the included page in place of the directive.
    include = re.fullmatch(r"\{\{#include (\S+)\}\}\s*", text)
    if include:
        return anchors((path.parent / include[1]).resolve())
    for heading in re.findall(r"^#+ +(.*)$", text, flags=re.M):
        name = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        name = re.sub(r"[^\w\- ]", "", name).replace(" ", "-")
        again = name
        count = 0
        while again in found:
            count += 1
            again = f"{name}-{count}"
        found.add(again)
    return found


listed = subprocess.run(["git", "ls-files", "*.md"], cwd=root, capture_output=True, text=True, check=True).stdout
broken, links = [], 0
for name in listed.split():
    page = root / name
    whole = page.read_text()
    # Reports and the changelog speak of their own time.
    if name != "CHANGELOG.md" and not name.startswith("experiments/"):
        for match in re.finditer(r"`((?:src|crates|tests|benches|python)/[\w./-]+\.\w+)`", whole):
            if not (root / match[1]).exists():
                broken.append(f"{name}:{whole.count(chr(10), 0, match.start()) + 1}: {match[1]}: no such file")
    text = prose(whole)
    for match in re.finditer(r"\]\(\s*<?([^)\s>]+)>?[^)]*\)|^\[[^\]]+\]:\s*(\S+)", text, flags=re.M):
        target = match[1] or match[2]
        if re.match(r"[a-z]+:", target):
            continue
        links += 1
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        line = text.count("\n", 0, match.start()) + 1
        if not file.exists() or os.path.commonpath([file, root]) != str(root):
            broken.append(f"{name}:{line}: {target}: no such file")
        elif anchor and file.suffix == ".md" and anchor not in anchors(file):
            broken.append(f"{name}:{line}: {target}: no such heading")

print("\n".join(broken) if broken else f"{links} relative links lead somewhere")
sys.exit(bool(broken))
