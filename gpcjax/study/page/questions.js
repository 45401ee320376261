// Questions as a form: scales, choices, free text.

import { element } from "/page/format.js";

/** @param {any} question @param {string} value @param {string} words */
function option({ name, needed }, value, words) {
  const input = element("input", { type: "radio", name, value });
  if (needed) input.setAttribute("required", "");
  return element("label", {}, input, element("span", {}, words));
}

function scale(question) {
  const points = Array.from({ length: question.points }, (_, k) => option(question, String(k + 1), String(k + 1)));
  const [low, high] = question.labels;
  const parts = [element("div", { class: "scale", role: "presentation" }, ...points)];
  if (low || high) parts.push(element("div", { class: "scale-ends" }, element("span", {}, `1: ${low}`), element("span", {}, `${question.points}: ${high}`)));
  return parts;
}

const choice = (question) => [element("div", { class: "choice" }, ...question.options.map((each) => option(question, each, each)))];

function text(question) {
  const area = element("textarea", { name: question.name, maxlength: String(question.longest), "aria-label": question.text });
  if (question.needed) area.setAttribute("required", "");
  return [area];
}

const KINDS = { scale, choice, text };

/** @param {any[]} questions @param {(values: Record<string, number|string|null>) => void} send */
export function form(questions, send) {
  const fields = questions.map((question) => {
    const optional = question.needed ? [] : [element("span", { class: "optional" }, " (if you like)")];
    return element("fieldset", { "data-name": question.name }, element("legend", {}, question.text, ...optional), ...KINDS[question.kind](question));
  });
  const trouble = element("p", { class: "bad", role: "alert" });
  const made = element("form", { novalidate: "" }, ...fields, trouble,
    element("p", { class: "actions" }, element("button", { class: "primary" }, "Send and go on")));
  made.addEventListener("submit", (event) => {
    event.preventDefault();
    const given = new FormData(made);
    const values = {};
    const missing = [];
    for (const { name, kind, needed } of questions) {
      const value = String(given.get(name) ?? "").trim();
      if (!value && needed) missing.push(name);
      values[name] = value === "" ? null : kind === "scale" ? Number(value) : value;
    }
    for (const field of fields) field.classList.toggle("missing", missing.includes(field.dataset.name));
    trouble.textContent = missing.length ? "Please answer the questions in red." : "";
    if (missing.length) fields.find((field) => field.classList.contains("missing"))?.querySelector("input, textarea")?.focus();
    else send(values);
  });
  return made;
}
