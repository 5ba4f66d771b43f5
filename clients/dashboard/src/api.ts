// The REST calls that the page makes, and the forms of their answers (openapi/openapi.json has them all).
export interface Status {
  station: string;
  state: "waiting" | "receiving" | "silent";
  reason: string;
  solution_status: string | null;
  n_satellites: number;
}

export interface Station {
  station: string;
  name: string;
  mode: string;
  status: Status;
}

export interface Alert {
  alert_id: string;
  station: string;
  severity: "warning" | "alarm";
  state: "active" | "acknowledged" | "cleared";
  text: string;
  onset: string;
}

interface Page<T> {
  items: T[];
  next: string | null;
}

async function all<T>(path: string): Promise<T[]> {
  const items: T[] = [];
  let cursor: string | null = null;
  do {
    const address: string = cursor ? `${path}&cursor=${encodeURIComponent(cursor)}` : path;
    const answer = await fetch(address);
    if (!answer.ok) throw new Error(`${address}: ${answer.status}`);
    const page = (await answer.json()) as Page<T>;
    items.push(...page.items);
    cursor = page.next;
  } while (cursor);
  return items;
}

/** Stations with a receiver; streams of corrections have no motion to show. */
export async function listStations(): Promise<Station[]> {
  return (await all<Station>("v1/stations?limit=500")).filter((s) => s.mode !== "corrections");
}

export const listAlerts = (): Promise<Alert[]> => all<Alert>("v1/alerts?limit=100&state=active");
