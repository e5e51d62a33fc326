// Sort and filter the table of policies, and write the command that compares the ticked ones.
(() => {
  const root = document.querySelector(".policies");
  const heads = [...root.querySelectorAll("th")], body = root.querySelector("tbody"), rows = [...body.rows];
  const [search, kind, order] = root.querySelectorAll("input[type=search], select.kind, select.sort");
  const command = root.querySelector(".command code"), usual = command.textContent;

  function sort(column, down) {
    const text = (row) => row.cells[column].textContent.trim();
    const value = (row) => (column < 2 ? text(row) : text(row) === "" ? null : Number(text(row)));
    rows.sort((a, b) => {
      const [x, y] = [value(a), value(b)];
      if (x === null || y === null) return (x === null) - (y === null);  // rows without a number are last
      return (down ? -1 : 1) * (typeof x === "string" ? x.localeCompare(y) : x - y);
    });
    body.append(...rows);
    heads.forEach((head, at) => at === column ? head.setAttribute("aria-sort", down ? "descending" : "ascending") : head.removeAttribute("aria-sort"));
  }
  const best = (column) => column >= 2 && column <= 4;  // more is better: first click sorts downwards
  heads.forEach((head, column) => {
    head.tabIndex = 0;
    const click = () => {
      const now = head.getAttribute("aria-sort");
      sort(column, now ? now === "ascending" : best(column));
    };
    head.addEventListener("click", click);
    head.addEventListener("keydown", (event) => event.key === "Enter" && click());
  });
  order.addEventListener("change", () => order.value !== "" && sort(Number(order.value), best(Number(order.value))));

  function filter() {
    const words = search.value.toLowerCase().split(/\s+/);
    for (const row of rows) {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every((word) => text.includes(word)) || (kind.value && row.dataset.kind !== kind.value);
    }
  }
  search.addEventListener("input", filter);
  kind.addEventListener("change", filter);

  body.addEventListener("change", () => {
    const names = [...body.querySelectorAll("input:checked")].map((box) => box.value);
    if (names.length === 1) names.push(names[0] === "hole_area" ? "random" : "hole_area");
    command.textContent = names.length ? `asg compare --policies ${names.join(",")}` : usual;
  });
  const button = root.querySelector(".command button");
  button.addEventListener("click", async () => {
    await navigator.clipboard.writeText(command.textContent);
    button.textContent = "copied";
    setTimeout(() => (button.textContent = "copy"), 1500);
  });
})();
