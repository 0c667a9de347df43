"""A page by the keyboard alone, in either browser: what the Tab key reaches, and whether it can be seen where it is."""

from __future__ import annotations

from typing import Any, Protocol

TAB, ENTER = "\ue004", "\ue007"
TABS_MAX = 250
"""Steps after which the focus is held to be caught."""

CONTROLS = (
    "a[href], button:not(:disabled), input:not([type=hidden]):not(:disabled), select:not(:disabled),"
    " textarea:not(:disabled), summary, [tabindex='0']"
)
NAMED = r"""(one) => one.matches('[type=radio]') ? `radio ${one.name}` :
  [one.localName, one.name, one.getAttribute('href') ?? '',
    one.ariaLabel || (one.querySelector('h1, h2') ?? one).textContent.trim()]
  .join(' ').replace(/\d+/g, '0').slice(0, 80)"""
"""Without what changes while it is looked at. Of radios the arrow keys go from one to the next: the Tab key reaches
their group."""
ALL_CONTROLS = f"""[...document.querySelectorAll("{CONTROLS}")].filter((one) =>
  one.checkVisibility({{ visibilityProperty: true }}) && !one.closest('[inert], svg')).map({NAMED})"""
FOCUSED = f"""((one) => {{
  if (!one || one === document.body || one === document.documentElement) return null;
  const box = one.getBoundingClientRect(), faults = [];
  const marked = [one, one.parentElement, one.closest('label')].some((at) => {{
    const style = at && getComputedStyle(at);
    const outlined = style && style.outlineStyle !== 'none' && parseFloat(style.outlineWidth) >= 1;
    return style && (outlined || style.boxShadow !== 'none');
  }});
  if (!marked && !one.closest('.q-field--focused')) faults.push('no mark of the focus');
  const off = box.bottom < 1 || box.top > innerHeight - 1 || box.right < 1 || box.left > innerWidth - 1;
  if (off) return [({NAMED})(one), [...faults, 'off the screen']];
  const x = Math.min(Math.max((box.left + box.right) / 2, 0), innerWidth - 1);
  const y = Math.min(Math.max((box.top + Math.min(box.bottom, box.top + 40)) / 2, 0), innerHeight - 1);
  const there = document.elementFromPoint(x, y);
  if (!there || !(one.contains(there) || there.contains(one) || one.closest('label')?.contains(there)))
    faults.push('under ' + (there?.outerHTML ?? 'nothing').slice(0, 90));
  return [({NAMED})(one), faults];
}})(document.activeElement)"""
"""Of what has the focus: its name, and what is wrong with it. The library's fields have a thick border then."""
DRAWN = f"new Promise((told) => requestAnimationFrame(() => requestAnimationFrame(() => told({FOCUSED}))))"
"""What is scrolled to stands there with the next picture."""
HEIGHT = "document.documentElement.scrollHeight"
FOCUS_AGAIN = "((one) => { one.blur(); one.focus(); })(document.activeElement)"
FROM_THE_TOP = """(() => {
  document.body.tabIndex = -1; document.body.focus(); document.body.removeAttribute('tabindex'); scrollTo(0, 0);
})()"""


class Keys(Protocol):
    """A tab that is asked and typed in."""

    async def evaluate(self, expression: str) -> Any: ...
    async def keys(self, text: str) -> None: ...
    async def until(self, expression: str, within_s: float = 60.0) -> None: ...


async def tabbed(face: Keys) -> tuple[int, list[str]]:
    """How many controls the Tab key reaches from the top of the page, and what is wrong.

    It stops where all are reached: behind the last the focus goes to the browser, and Firefox does not give it back."""
    await face.evaluate(FROM_THE_TOP)
    reached: dict[str, list[str]] = {}
    there = set(await face.evaluate(ALL_CONTROLS))
    for _ in range(TABS_MAX):
        if there <= reached.keys():
            break
        height = await face.evaluate(HEIGHT)
        await face.keys(TAB)
        at = await face.evaluate(DRAWN)
        if at is not None and "off the screen" in at[1] and await face.evaluate(HEIGHT) != height:
            # the page grew after it was scrolled, as the prompt of the next pose takes a line more
            await face.evaluate(FOCUS_AGAIN)
            at = await face.evaluate(DRAWN)
        if at is None or at[0] == next(iter(reached), None):
            break
        reached[at[0]] = [*reached.get(at[0], []), *at[1]]
    else:
        return len(reached), [f"the Tab key is caught in {at[0]}"]
    left = sorted(set(await face.evaluate(ALL_CONTROLS)) - set(reached))
    await face.evaluate(FROM_THE_TOP)
    wrong = [f"by the Tab key, {name}: {one}" for name, found in reached.items() for one in dict.fromkeys(found)]
    return len(reached), [*wrong, *(f"not reached by the Tab key: {name}" for name in left)]


async def reach(face: Keys, selector: str) -> None:
    """Go there by the Tab key. Raises AssertionError where it does not lead there."""
    await face.until(f"document.querySelector({selector!r})?.checkVisibility()")
    await face.evaluate(FROM_THE_TOP)
    for _ in range(TABS_MAX):
        await face.keys(TAB)
        if await face.evaluate(f"!!document.activeElement?.matches({selector!r})"):
            return
    raise AssertionError(f"the Tab key does not lead to {selector}")
