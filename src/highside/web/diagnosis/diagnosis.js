// How the job stands, every two seconds; the page is loaded anew when it has come to another stage.
"use strict";
const words = document.getElementById("words");
async function ask() {
  try {
    const answer = await fetch("/diagnosis/state");
    const state = await answer.json();
    words.textContent = state.words;
    document.body.classList.remove("lost");
    if (state.stage !== words.dataset.stage) {
      location.reload();
      return;
    }
  } catch {
    document.body.classList.add("lost");
  }
  setTimeout(ask, 2000);
}
setTimeout(ask, 1000);
