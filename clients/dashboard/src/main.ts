// The page: a card for every station, the alerts above them, one WebSocket for everything live.
import "./style.css";
import { AlertList } from "./alerts";
import { listOpenAlerts, listStations, type Station } from "./api";
import { StationCard } from "./station-card";
import { LiveStream } from "./stream";

const REFRESH_MS = 5_000; // how often the list of stations is asked for
const host = document.getElementById("stations")!;
const cards = new Map<string, StationCard>();
const alerts = new AlertList(document.getElementById("alerts")!, (station) => cards.get(station)?.name ?? station);

function show(station: Station): StationCard {
  const known = cards.get(station.station);
  if (known) return known;
  const card = new StationCard(station.station, station.name, station.mode);
  cards.set(station.station, card);
  host.querySelector(".empty")?.remove();
  host.append(card.element);
  card.mounted();
  card.status(station.status);
  return card;
}

async function refresh(): Promise<void> {
  const [stations, open] = await Promise.all([listStations(), listOpenAlerts()]);
  alerts.replaceOpen(open);
  stations.forEach(show);
  const present = new Set(stations.map((s) => s.station));
  for (const [id, card] of cards) {
    if (present.has(id)) continue;
    card.element.remove();
    cards.delete(id);
  }
  if (!cards.size) host.innerHTML = `<p class="empty">No stations yet. Add one with POST /v1/stations.</p>`;
}

function summarise(): void {
  const states = [...cards.values()].map((c) => c.element.querySelector<HTMLElement>(".state")!.dataset.state);
  const receiving = states.filter((s) => s === "receiving").length;
  const { active, open } = alerts.counts;
  const told = open ? `, ${open} alert${open > 1 ? "s" : ""} open` + (active ? `, ${active} not seen yet` : "") : "";
  document.getElementById("summary")!.textContent = `${receiving} of ${cards.size} receiving${told}`;
  document.title = active ? `(${active}) plumbline` : "plumbline";
  for (const card of cards.values()) card.rank(alerts.severityOf(card.station));
}

const link = document.getElementById("link")!;
new LiveStream({
  link: (state, words) => {
    link.dataset.state = state;
    link.textContent = words;
  },
  status: (status) => cards.get(status.station)?.status(status),
  motion: (station, block) => cards.get(station)?.motion(block),
  attitude: (attitude) => cards.get(attitude.station)?.attitude(attitude),
  alert: (alert) => alerts.add(alert),
}).open();

function frame(): void {
  for (const card of cards.values()) card.draw();
  summarise();
  setTimeout(() => requestAnimationFrame(frame), 100); // ten pictures a second are plenty
}

void refresh().catch(() => undefined);
setInterval(() => void refresh().catch(() => undefined), REFRESH_MS);
frame();
