// How the job stands, every two seconds; the page is loaded anew when it has come to another stage.
"use strict";
const WAITED_MS = 5000; // a cable that was pulled answers nothing at all
const words = document.getElementById("words");
function lost(so) {
  document.body.classList.toggle("lost", so);
  document.getElementById("lost").hidden = !so;
}
async function ask() {
  try {
    const answer = await fetch("/diagnosis/state", { signal: AbortSignal.timeout(WAITED_MS) });
    const state = await answer.json();
    words.textContent = state.words;
    lost(false);
    if (state.stage !== words.dataset.stage) {
      location.reload();
      return;
    }
  } catch {
    lost(true);
  }
  setTimeout(ask, 2000);
}
setTimeout(ask, 1000);
