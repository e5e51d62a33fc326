"use strict";
(() => {
  const root = document.documentElement;

  // Light or dark theme: the system's setting until the button is used; stored if the browser permits it for local files.
  const kept = (value) => {
    try {
      if (value) localStorage.setItem("asg-theme", value);
      return localStorage.getItem("asg-theme");
    } catch {
      return null;
    }
  };
  const before = kept();
  if (before === "light" || before === "dark") root.dataset.theme = before;
  document.getElementById("theme").addEventListener("click", () => {
    const system = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
    root.dataset.theme = (root.dataset.theme || system) === "dark" ? "light" : "dark";
    kept(root.dataset.theme);
  });

  // Sort tables: numbers by value, then texts by letters, empty cells last.
  const key = (row, column) => {
    const cell = row.cells[column];
    const value = cell.dataset.value;
    if (value !== undefined) return Number(value);
    const text = cell.textContent.trim();
    const number = text ? Number(text.replaceAll(",", "").replace("−", "-")) : NaN;
    return Number.isNaN(number) ? text : number;
  };
  const compare = (a, b) => {
    const numbers = [a, b].map((value) => typeof value === "number");
    if (numbers[0] && numbers[1]) return a - b;
    if (numbers[0] !== numbers[1]) return numbers[0] ? -1 : 1;
    return a.localeCompare(b, undefined, { numeric: true });
  };
  // Turn blocks of rows into one: each row gets a copy of the first cell, which spans the rows of its block.
  const flatten = (table) => {
    for (const head of table.querySelectorAll("tbody th[rowspan]")) {
      let row = head.parentElement;
      const rows = head.rowSpan;
      head.removeAttribute("rowspan");
      for (let n = 1; n < rows; n++) {
        row = row.nextElementSibling;
        row.prepend(head.cloneNode(true));
      }
    }
    const [body, ...others] = table.tBodies;
    for (const other of others) {
      body.append(...other.rows);
      other.remove();
    }
  };
  const makeSortable = (table) => {
    for (const button of table.querySelectorAll("thead button")) {
      button.addEventListener("click", () => {
        const head = button.closest("th");
        const column = Number(button.dataset.column);
        const up = head.getAttribute("aria-sort") !== "ascending";
        for (const other of table.querySelectorAll("th[aria-sort]")) other.removeAttribute("aria-sort");
        head.setAttribute("aria-sort", up ? "ascending" : "descending");
        flatten(table);
        const body = table.tBodies[0];
        const rows = [...body.rows].sort((a, b) => {
          const keys = [key(a, column), key(b, column)];
          const mixed = (typeof keys[0] === "number") !== (typeof keys[1] === "number");
          const order = compare(keys[0], keys[1]);
          return up || mixed ? order : -order;
        });
        body.append(...rows);
      });
    }
  };

  // Name the cells of a table by their headings: narrow screens show a row as a list.
  const label = (table) => {
    const headings = [...table.tHead.rows[table.tHead.rows.length - 1].cells].map((head) => head.textContent);
    for (const row of table.tBodies[0].parentElement.querySelectorAll("tbody tr")) {
      const cells = [...row.cells].reverse();
      for (const [n, cell] of cells.entries()) cell.dataset.label = headings[headings.length - 1 - n];
    }
    table.classList.add("labelled");
  };

  // Show a hint next to tables with hidden columns on the right.
  const hint = (box) => {
    box.parentElement.classList.toggle("cut", box.scrollLeft + box.clientWidth < box.scrollWidth - 2);
    box.parentElement.style.setProperty("--tall", `${box.offsetHeight - 2}px`);
  };
  const sizes = new ResizeObserver((entries) => entries.forEach((entry) => hint(entry.target)));
  // Enlarge images: click or Enter opens, click or Escape closes, arrow keys select the previous or next image.
  const overlay = document.getElementById("enlarged");
  const images = [...document.querySelectorAll("main img")];
  const large = new Image();
  const show = (image) => {
    overlay.dataset.at = images.indexOf(image);
    large.src = image.src;
    large.alt = image.alt;
    // Sizes from the markup, since lazy images may not be loaded yet.
    large.style.setProperty("--ratio", image.getAttribute("width") / image.getAttribute("height"));
    overlay.querySelector("figcaption").textContent = `${image.alt} (← →)`;
    overlay.querySelector("figure").prepend(large);
    if (!overlay.open) overlay.showModal();
  };
  for (const image of images) {
    image.tabIndex = 0;
    image.setAttribute("role", "button");
    image.addEventListener("click", () => show(image));
    image.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      show(image);
    });
  }
  overlay.addEventListener("click", () => overlay.close());
  overlay.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    const next = images[Number(overlay.dataset.at) + step];
    if (next) show(next);
  });

  // Hide and show a policy's curves in all charts.
  const legend = [...document.querySelectorAll("button.legend")];
  const follow = (button, part) => {
    const shown = button.getAttribute("aria-pressed") === "true";
    for (const series of part.querySelectorAll(`.series.${button.dataset.series}`)) {
      if (series.classList.contains("rest")) series.classList.toggle("lit", shown);
      else series.classList.toggle("off", !shown);
    }
  };
  for (const button of legend) {
    button.addEventListener("click", () => {
      button.setAttribute("aria-pressed", String(button.getAttribute("aria-pressed") !== "true"));
      follow(button, document);
    });
  }

  // Show a line at the pointer and the value of each curve there.
  const svgNamespace = "http://www.w3.org/2000/svg";
  const reading = document.createElement("div");
  reading.className = "reading";
  reading.hidden = true;
  document.body.append(reading);
  const numbersOf = (text) => text.split(" ").map(Number);
  const pointsOf = (series) => {  // first point, then relative steps
    const numbers = series.querySelector(".curve").getAttribute("d").match(/-?[\d.]+/g).map(Number);
    const points = [[numbers[0], numbers[1]]];
    for (let at = 2; at < numbers.length; at += 2) {
      const [x, y] = points[points.length - 1];
      points.push([x + numbers[at], y + numbers[at + 1]]);
    }
    return points;
  };
  const makeReadable = (chart) => {
    const [left, top, right, bottom] = numbersOf(chart.dataset.frame);
    const [xLow, xHigh] = numbersOf(chart.dataset.x);
    const [yLow, yHigh] = numbersOf(chart.dataset.y);
    const probe = document.createElementNS(svgNamespace, "path");
    probe.setAttribute("class", "probe");
    chart.append(probe);
    const away = () => {
      reading.hidden = true;
      probe.removeAttribute("d");
    };
    chart.addEventListener("pointerleave", away);
    chart.addEventListener("pointermove", (event) => {
      const box = chart.getBoundingClientRect();
      const x = ((event.clientX - box.left) / box.width) * chart.viewBox.baseVal.width;
      if (x < left || x > right) return away();
      const lines = [];
      for (const series of chart.querySelectorAll(".series:not(.off):not(.rest), .series.lit")) {
        const points = pointsOf(series);
        if (x < points[0][0] - 1 || x > points[points.length - 1][0] + 1) continue;
        const after = Math.max(1, points.findIndex((point) => point[0] >= x));
        const [a, b] = [points[after - 1], points[Math.min(after, points.length - 1)]];
        const share = b[0] > a[0] ? Math.min(1, Math.max(0, (x - a[0]) / (b[0] - a[0]))) : 0;
        const y = a[1] + share * (b[1] - a[1]);
        lines.push([yLow + ((bottom - y) / (bottom - top)) * (yHigh - yLow), series.dataset.name]);
      }
      lines.sort((a, b) => b[0] - a[0]);
      const place = xLow + ((x - left) / (right - left)) * (xHigh - xLow);
      const unit = chart.dataset.unit.split("|")[0];
      reading.replaceChildren();
      const rows = [`${unit}: ${place.toFixed(place < 20 ? 1 : 0)}`];
      for (const [value, name] of lines) rows.push(`${value.toFixed(2)}  ${name}`);
      for (const text of rows) {
        const row = document.createElement("div");
        row.textContent = text;
        reading.append(row);
      }
      reading.hidden = false;
      const width = reading.offsetWidth;
      const at = event.pageX + 16 + width > scrollX + innerWidth ? event.pageX - 16 - width : event.pageX + 16;
      reading.style.left = `${Math.max(scrollX + 4, at)}px`;
      reading.style.top = `${event.pageY + 12}px`;
      probe.setAttribute("d", `M${x} ${top}V${bottom}`);
    });
  };

  // Add behaviour to a part of the page, at the start or after it was unpacked.
  const dress = (part) => {
    part.querySelectorAll("table.sortable").forEach(makeSortable);
    for (const table of part.querySelectorAll("figure.table table")) if (!table.closest(".trace")) label(table);
    part.querySelectorAll("svg.chart[data-frame]").forEach(makeReadable);
    for (const button of legend) follow(button, part);
    for (const box of part.querySelectorAll("figure.table > .wide")) {
      sizes.observe(box);
      box.addEventListener("scroll", () => hint(box), { passive: true });
    }
  };
  dress(document);

  // Unpack folded parts when the first of a group is opened.
  const unpack = async (word) => {
    const bytes = Uint8Array.from(atob(word), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return JSON.parse(await new Response(stream).text());
  };
  // Copy the code before a button, or the LaTeX of a table.
  document.addEventListener("click", async (event) => {
    const button = event.target.closest("button.copy");
    if (!button) return;
    const packed = button.dataset.latex;
    const text = packed ? (await unpack(packed))[0] : button.previousElementSibling.textContent;
    const before = button.textContent;
    try {
      await navigator.clipboard.writeText(text);
      button.textContent = "copied";
      setTimeout(() => { button.textContent = before; }, 1500);
    } catch {
      prompt("Copy this text:", text);
    }
  });
  // The list of sections is closed on narrow screens, and after a choice in it.
  const menu = document.querySelector("nav .menu");
  const narrow = matchMedia("(max-width: 760px)");
  const fold = () => { menu.open = !narrow.matches; };
  narrow.addEventListener("change", fold);
  menu.addEventListener("click", (event) => { if (event.target.closest("a")) fold(); });
  fold();

  for (const group of document.querySelectorAll(".packed")) {
    let texts;
    const folded = [...group.querySelectorAll(":scope > details")];
    for (const [number, part] of folded.entries()) {
      const open = async () => {
        texts ??= unpack(group.dataset.packed);
        try {
          part.insertAdjacentHTML("beforeend", (await texts)[number]);
          dress(part);
        } catch {
          part.append("This browser cannot unpack the folded parts.");
        }
      };
      part.addEventListener("toggle", open, { once: true });
    }
  }
})();
