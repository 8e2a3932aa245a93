// The field on "When it goes wrong": of all messages, those most like what is pasted into it.
"use strict";

(function () {
  const words = (text) => text.toLowerCase().match(/[\p{L}\p{N}_.-]{2,}/gu) || [];

  /** Weights of words: one that few messages have says more. */
  function weights(messages) {
    const counts = new Map();
    for (const [form] of messages) for (const word of new Set(words(form))) counts.set(word, (counts.get(word) || 0) + 1);
    return (word) => Math.log(1 + messages.length / (counts.get(word) || messages.length));
  }

  /** The messages of which most is found in a text, best first. */
  function likest(text, messages, weight) {
    const given = new Set(words(text));
    const rated = messages.map((message) => {
      const own = words(message[0]);
      let found = 0, all = 0;
      for (const word of own) {
        all += weight(word);
        if (given.has(word)) found += weight(word);
      }
      return { message, found, share: all ? found / all : 0 };
    });
    const likely = rated.filter((one) => one.share > 0.5 || one.found > 8);
    return likely.sort((a, b) => b.share * b.found - a.share * a.found).slice(0, 5).map((one) => one.message);
  }

  function show(list, found, text) {
    list.replaceChildren(...found.map(([form, heading, address]) => {
      const item = document.createElement("li");
      const code = document.createElement("code");
      code.textContent = form;
      const link = document.createElement("a");
      link.href = address;
      link.textContent = heading;
      item.append(code, " – ", link);
      return item;
    }));
    if (text.trim() && !found.length) list.textContent = "Nothing like it. Try fewer words, or the search of these pages.";
  }

  window.addEventListener("DOMContentLoaded", () => {
    const field = document.getElementById("pasted-message");
    const list = document.getElementById("found-messages");
    const messages = window.scanloomMessages;
    if (!field || !list || !messages) return;
    const weight = weights(messages);
    field.addEventListener("input", () => show(list, likest(field.value, messages, weight), field.value));
  });
})();
