// Tables as text: Markdown, LaTeX and CSV.

const ESCAPES = {
  "\\": "\\textbackslash{}",
  "&": "\\&",
  "%": "\\%",
  $: "\\$",
  "#": "\\#",
  _: "\\_",
  "{": "\\{",
  "}": "\\}",
  "~": "\\textasciitilde{}",
  "^": "\\textasciicircum{}",
  "†": "\\dag{}",
  "–": "--",
};

/** A table of texts, header first, in a format: markdown, latex or csv. */
export function asText(rows, format) {
  const [header, ...body] = rows;
  if (format === "csv") return rows.map((row) => row.map(quote).join(",")).join("\n") + "\n";
  if (format === "latex") {
    const line = (row) =>
      `${row.map((text) => text.replace(/[\\&%$#_{}~^†–]/g, (letter) => ESCAPES[letter])).join(" & ")} \\\\`;
    return [
      "% needs \\usepackage{booktabs}",
      `\\begin{tabular}{l${"r".repeat(header.length - 1)}}`,
      "\\toprule",
      line(header),
      "\\midrule",
      ...body.map(line),
      "\\bottomrule",
      "\\end{tabular}",
      "",
    ].join("\n");
  }
  const line = (row) => `| ${row.map((text) => text.replaceAll("|", "\\|")).join(" | ")} |`;
  return [
    line(header),
    `|---|${header
      .slice(1)
      .map(() => "--:|")
      .join("")}`,
    ...body.map(line),
    "",
  ].join("\n");
}

/** Put text into the clipboard; false where the browser does not allow it. */
export async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    return false;
  }
}

function quote(text) {
  return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}
