// A form is sent once the server has answered that it is there and still knows who sends: otherwise what was written
// stays where it is, and why nothing was sent is told. A file is sent from the page, which stays until it has arrived.
(() => {
  "use strict";
  const WAITED_MS = 5000; // a cable that was pulled answers nothing at all
  const UPLOAD_MS = 300000; // as the server
  const AGAIN_MS = 1500; // a second click on the way to the next page
  const busy = new WeakSet(), changed = new Set();
  let checked = null; // the form whose sending was found to be possible

  function tell(form, name, text) {
    for (const line of document.querySelectorAll("[data-told]")) line.remove();
    const found = name && document.querySelector(`template[data-unsent=${name}]`);
    if (!found) return;
    const line = found.content.firstElementChild.cloneNode(true);
    if (text) line.querySelector("span").textContent = text;
    line.dataset.told = name;
    form.append(line);
    line.scrollIntoView({ block: "nearest" });
  }

  async function hindrance() {
    try {
      const answer = await fetch("/here", { cache: "no-store", signal: AbortSignal.timeout(WAITED_MS) });
      const here = await answer.json(), who = document.body.dataset.who;
      return !who || here.who === who ? "" : "gone";
    } catch {
      return "lost";
    }
  }

  async function upload(form) {
    const most = 1e6 * Number(form.dataset.most);
    if ([...form.querySelectorAll("[type=file]")].some((one) => one.files[0]?.size > most)) return ["large"];
    const end = new AbortController(), timer = setTimeout(() => end.abort(), UPLOAD_MS), cut = () => end.abort();
    addEventListener("offline", cut);
    try {
      const answer = await fetch(form.action, { method: "POST", body: new FormData(form), signal: end.signal });
      const page = await answer.text();
      if (answer.redirected) {
        changed.delete(form);
        location.assign(answer.url);
        return [""];
      }
      const said = new DOMParser().parseFromString(page, "text/html");
      return ["refused", (said.querySelector(".alarm > span") ?? said.body).textContent.trim()];
    } catch {
      return ["cut"];
    } finally {
      clearTimeout(timer);
      removeEventListener("offline", cut);
    }
  }

  async function send(form, submitter) {
    const why = await hindrance();
    tell(form, why);
    if (!why && form.dataset.most) tell(form, ...(await upload(form)));
    if (why || form.dataset.most) return busy.delete(form);
    changed.delete(form);
    checked = form;
    form.requestSubmit(submitter);
    setTimeout(() => busy.delete(form), AGAIN_MS);
  }

  document.addEventListener("submit", (event) => {
    const form = event.target;
    if (checked === form) {
      checked = null;
      return;
    }
    event.preventDefault();
    if (busy.has(form)) return;
    busy.add(form);
    send(form, event.submitter);
  });

  // a language, another page or a step back would take what was written away: the browser asks first
  document.addEventListener("input", (event) => {
    const form = event.target.form;
    if (form?.matches(".form") && event.target.type !== "password") changed.add(form);
  });
  addEventListener("beforeunload", (event) => {
    if (changed.size) event.preventDefault();
  });
})();
