for (const box of document.querySelectorAll("[data-scrubber]")) {
  const data = JSON.parse(document.getElementById(box.dataset.scrubber).textContent);
  const all = name => [...box.querySelectorAll(name)];
  const slider = box.querySelector("input"), said = box.querySelector("output"), cursor = box.querySelector(".cursor");
  const poles = all(".pole"), dots = all(".dot");
  const put = (node, x, y) => node.setAttribute("transform", `translate(${x ?? -99} ${y ?? -99})`);
  const show = i => {
    slider.value = i;
    said.textContent = data.say[i];
    slider.setAttribute("aria-valuetext", data.say[i]);
    poles.forEach((node, k) => put(node, data.px[i][k], data.py[i][k]));
    dots.forEach((node, k) => put(node, data.cx[i], data.cy[k][i]));
    put(cursor, data.cx[i], 0);
  };
  slider.max = data.say.length - 1;
  slider.oninput = () => show(+slider.value);
  box.querySelector("button").onclick = () => show(data.worst);
  addEventListener("beforeprint", () => show(data.worst));
  box.querySelector(".controls").hidden = false;
  show(data.worst);
}
