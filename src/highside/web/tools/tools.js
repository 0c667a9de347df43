// What is shown is replaced as a whole when it has changed: who is on a link of it stays there, what is open stays open.
(() => {
  "use strict";
  const PAGE = ".tools-page, .tool-page", PLACES = "a[href], summary";
  let place = null;
  const opened = new Set();
  const within = (target, what) => target.closest?.(PAGE) ? target.closest(what) : null;
  const name = (one) => one.tagName + (one.getAttribute("href") ?? one.textContent);

  document.addEventListener("focusin", (event) => {
    const one = within(event.target, PLACES);
    place = one ? name(one) : null;
  });
  // who goes elsewhere leaves a place that is still there; what is taken away is gone when this is looked at
  document.addEventListener("focusout", (event) => queueMicrotask(() => {
    if (event.target.isConnected && document.activeElement !== event.target) place = null;
  }));
  document.addEventListener("toggle", (event) => {
    const words = within(event.target, "details")?.querySelector("summary")?.textContent;
    if (!words || !event.target.isConnected) return;
    if (event.target.open) opened.add(words);
    else opened.delete(words);
  }, true);

  function keep() {
    for (const one of document.querySelectorAll(`:is(${PAGE}) details:not([open])`))
      if (opened.has(one.querySelector("summary")?.textContent)) one.open = true;
    if (place === null || document.activeElement !== document.body) return;
    for (const one of document.querySelectorAll(`:is(${PAGE}) :is(${PLACES})`))
      if (name(one) === place) {
        one.focus({ preventScroll: true });
        return;
      }
  }

  document.addEventListener("DOMContentLoaded", () => {
    new MutationObserver(keep).observe(document.body, { childList: true, subtree: true });
  });
})();
