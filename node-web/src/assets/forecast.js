// What the planner foresees of the rest of the night: made once by the server for all who look.
import { useShared } from "./api.js";

/** The forecast of the schedule in force as a GET; its data is null without one, and the rest of a page is still shown. */
export const useForecast = (id) => useShared(`/api/v1/telescopes/${id}/forecast`, 60);
