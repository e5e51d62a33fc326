"use strict";
// Play the films stored in the page.
(async () => {
  try {
    const films = await Promise.all(Array.from(document.querySelectorAll("script.recording"), (part) => unpackText(part.textContent)));
    window.player = new Player(films.map((one, number) => new Run(one, number)));
  } catch (error) {
    find("runs").append(element("p", { className: "warning" }, `This replay cannot be shown: ${error.message}`));
    throw error;
  }
})();
