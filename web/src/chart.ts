import data from "./data.json";
import type { Found } from "./search";

const [left, right, top, bottom] = [34, 302, 8, 128];
const labels = [0, 1, 2, 3].map((third) => (third * data.search.budget_s) / 3);

/** Draw the distance of each robot of a search and the best one so far, over the simulated time. */
export function drawChart(svg: SVGElement, found: Found): void {
  const topMm = Math.max(100, Math.ceil((1000 * found.bestM) / 100) * 100);
  const x = (timeS: number) => left + ((right - left) * timeS) / Math.max(data.search.budget_s, found.simulatedS);
  const y = (distanceM: number) => bottom - ((bottom - top) * 1000 * distanceM) / topMm;
  let bestM = 0;
  let path = `M${left} ${bottom}`;
  const robots = found.distancesM.map((distanceM, i) => {
    const at = x(found.timesS[i]);
    bestM = Math.max(bestM, distanceM);
    path += `H${at.toFixed(1)}V${y(bestM).toFixed(1)}`;
    return `<circle class="robot" cx="${at.toFixed(1)}" cy="${y(distanceM).toFixed(1)}" r="2"/>`;
  });
  const heights = [0, topMm / 2, topMm].map((mm) => {
    const at = y(mm / 1000);
    return `<line class="axis" x1="${left}" x2="${right}" y1="${at}" y2="${at}"/><text x="${left - 4}" y="${at + 3}" text-anchor="end">${mm}</text>`;
  });
  const times = labels.map((s) => `<text x="${x(s)}" y="${bottom + 13}" text-anchor="middle">${s}</text>`);
  svg.innerHTML =
    heights.join("") + times.join("") + robots.join("") + `<path class="best" d="${path}"/>` +
    `<text x="${(left + right) / 2}" y="157" text-anchor="middle">simulated time in s, distance in mm</text>`;
  svg.classList.add("filled");
}
