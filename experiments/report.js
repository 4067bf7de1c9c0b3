// Opens what a link leads to, fills the pictures of the first screen, and searches the page.
const all = (selector) => [...document.querySelectorAll(selector)];

function reveal() {
  const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  const folded = target && (target.closest("details") || target.querySelector("details"));
  if (folded) {
    folded.open = true;
    target.scrollIntoView();
  }
}
addEventListener("hashchange", reveal);
reveal();

for (const image of all("img[data-of]"))
  image.src = document.getElementById(image.dataset.of).querySelector("img").src;

const items = all("section .claims li, section .table, section figure").map((item) => {
  const title = item.closest("section").querySelector("h2").textContent;
  return { item, text: `${title} ${item.textContent}`.toLowerCase() };
});
const input = document.querySelector("input[type=search]");
input.addEventListener("input", () => {
  const words = input.value.toLowerCase().split(/\s+/).filter(Boolean);
  let hits = 0;
  for (const { item, text } of items) hits += !(item.hidden = !words.every((word) => text.includes(word)));
  document.querySelector("header").hidden = words.length > 0;
  for (const section of all("section")) {
    section.hidden = !items.some(({ item }) => !item.hidden && section.contains(item));
    section.querySelector("details").open = words.length > 0;
  }
  document.querySelector("[role=status]").textContent = words.length ? `${hits} found` : "";
});
addEventListener("beforeprint", () => all("section > details").forEach((folded) => (folded.open = true)));
