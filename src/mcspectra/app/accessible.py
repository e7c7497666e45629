"""Names for what widgets leave nameless: handles of sliders, check boxes, spin buttons, files.

Bokeh labels text fields and lists itself. The rest gets an ``aria-label`` from the words that stand
beside it, by a script that looks again every second, since widgets come and go.
"""

from __future__ import annotations

from typing import Any

__all__ = ["name_widgets"]

_SCRIPT = r"""
const words = (root, choice) => {
  const found = root.querySelector(choice);
  return found ? found.textContent.replace(/:.*$/s, "").trim() : "";
};
const said = (root) => [...root.children].filter((e) => !["STYLE", "LINK"].includes(e.tagName))
  .map((e) => e.textContent).join(" ").trim();
// A slider over a list has its words in the widget before it.
const before = (root) => {
  const other = root.host && root.host.previousElementSibling;
  return other && other.shadowRoot ? said(other.shadowRoot).replace(/:.*$/s, "").trim() : "";
};
const name = (element, text) => {
  if (text && !element.getAttribute("aria-label")) element.setAttribute("aria-label", text);
};
const visit = (root) => {
  for (const handle of root.querySelectorAll(".noUi-handle"))
    name(handle, words(root, ".bk-slider-title, label") || before(root));
  for (const box of root.querySelectorAll("input[type=checkbox]"))
    name(box, (box.parentElement || box).textContent.trim() || said(root));
  for (const file of root.querySelectorAll("input[type=file]"))
    name(file, "Picture as integrand");
  root.querySelectorAll("button.bk-spin-btn, .bk-spin-btn-up, .bk-spin-btn-down").forEach((b) =>
    name(b, (b.classList.contains("bk-spin-btn-up") ? "Increase " : "Decrease ")
      + words(root, "label")));
  for (const bar of root.querySelectorAll("progress")) name(bar, "Progress");
  for (const each of root.querySelectorAll("*")) if (each.shadowRoot) visit(each.shadowRoot);
};
visit(document);
setInterval(() => visit(document), 1000);
"""


def name_widgets(document: Any) -> None:
    """Have the script run in the page of a document, if there is one."""
    from bokeh.events import DocumentReady
    from bokeh.models import CustomJS

    if document is not None:
        document.js_on_event(DocumentReady, CustomJS(code=_SCRIPT))
