// Starts the desk on its page.
import { startDesk } from "./ui.js";

export const desk = startDesk(document.getElementById("desk"), window.deskMachines);
